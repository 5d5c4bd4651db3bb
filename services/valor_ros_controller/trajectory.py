"""Joint trajectories: checked way-points, and splines through them.

The meaning is that of ros2_controllers' ``joint_trajectory_controller`` (Jazzy): between two points that both carry
velocities the path is cubic, with accelerations quintic, else linear; before the first point it comes from where the
robot was told to be. What is stricter here: every number is finite, every point and every point of the splines lies
within the joints' limits, and no trajectory begins with a jump. No input or output in this module.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

Vector = npt.NDArray[np.float64]

SPEED_MARGIN = 1.01
"""How far the peak of a spline may exceed the speed limit: planners place way-points at the limit itself."""
START_TOLERANCE = 0.1
"""How far a point at time 0 may be from the present set-point [rad]: it tells where the planner thought we were."""
LONGEST_WAIT = 600.0
"""A trajectory may not begin later than this [s]: a later one is stamped with another clock."""

_SAMPLES = 33  # a segment is looked at in so many places when its limits are checked
_CHUNK = 64  # segments at a time: bounds the memory of the check
_END_VELOCITY = 1e-6  # [rad/s]


class ErrorCode(IntEnum):
    """As ``control_msgs/action/FollowJointTrajectory`` numbers them."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class InvalidTrajectoryError(ValueError):
    """A trajectory that is not obeyed: its text names the joint, the value and the limit."""

    def __init__(self, code: ErrorCode, text: str) -> None:
        super().__init__(text)
        self.code = code


@dataclass(frozen=True)
class JointLimits:
    """Names and limits of a controller's joints, in the controller's order; length n."""

    names: tuple[str, ...]
    lower: Vector  # (n,) [rad]
    upper: Vector  # (n,) [rad]
    velocity: Vector  # (n,) [rad/s]


@dataclass(frozen=True)
class Point:
    """A way-point as it came: sequences have one entry a joint, or none."""

    positions: Sequence[float]  # [rad]
    velocities: Sequence[float]  # [rad/s]
    accelerations: Sequence[float]  # [rad/s²]
    effort: Sequence[float]  # [N·m]
    time_from_start: float  # [s]


@dataclass(frozen=True)
class Waypoints:
    """A checked trajectory, k points of m joints.

    Attributes:
        columns: (m,) places of the joints in the controller's order.
        times: (k,) from the start of the trajectory, increasing [s].
        order: (k,) what each point carries: 1 positions, 3 also velocities, 5 also accelerations.
        coefficients: (k-1, 6, m) of the splines between the points, lowest power first.
    """

    columns: npt.NDArray[np.intp]
    times: Vector
    positions: Vector
    velocities: Vector
    accelerations: Vector
    order: npt.NDArray[np.intp]
    coefficients: Vector


def spline(
    start: tuple[Vector, Vector, Vector],
    end: tuple[Vector, Vector, Vector],
    duration: Vector,
    order: npt.NDArray[np.intp],
) -> Vector:
    """Coefficients of the polynomials between pairs of states (position, velocity, acceleration).

    Args:
        start: (k, m) each.
        end: (k, m) each.
        duration: (k,) [s], positive.
        order: (k,) 1 linear, 3 cubic, 5 quintic; what is not met by the order is ignored.

    Returns:
        (k, 6, m) lowest power first, in time since the segment began [s].
    """
    (p0, v0, a0), (p1, v1, a1) = start, end
    T = duration[:, None]
    c = np.zeros((len(duration), 6, p0.shape[1]))
    with np.errstate(all="ignore"):  # what overflows is found by the limits
        distance = p1 - p0
        c[:, 0] = p0
        linear, cubic, quintic = order == 1, order == 3, order == 5
        c[linear, 1] = (distance / T)[linear]
        c[cubic, 1] = v0[cubic]
        c[cubic, 2] = ((3 * distance - (2 * v0 + v1) * T) / T**2)[cubic]
        c[cubic, 3] = ((-2 * distance + (v0 + v1) * T) / T**3)[cubic]
        c[quintic, 1] = v0[quintic]
        c[quintic, 2] = (0.5 * a0)[quintic]
        c[quintic, 3] = ((20 * distance - (12 * v0 + 8 * v1) * T - (3 * a0 - a1) * T**2) / (2 * T**3))[quintic]
        c[quintic, 4] = ((-30 * distance + (16 * v0 + 14 * v1) * T + (3 * a0 - 2 * a1) * T**2) / (2 * T**4))[quintic]
        c[quintic, 5] = ((12 * distance - 6 * (v0 + v1) * T - (a0 - a1) * T**2) / (2 * T**5))[quintic]
    return c


def _powers(time: Vector) -> tuple[Vector, Vector]:
    """(…, 6) powers of time for position, and their derivatives for velocity."""
    ones = np.ones_like(time)
    position = np.stack([ones, time, time**2, time**3, time**4, time**5], axis=-1)
    velocity = np.stack([0 * ones, ones, 2 * time, 3 * time**2, 4 * time**3, 5 * time**4], axis=-1)
    return position, velocity


def check_segments(
    coefficients: Vector,
    duration: Vector,
    limits: JointLimits,
    columns: npt.NDArray[np.intp],
    describe: str = "between points {0} and {1}",
) -> None:
    """Whether splines keep within the limits of position and speed everywhere.

    Args:
        coefficients: (k, 6, m).
        duration: (k,) [s].
        limits: of the controller's joints.
        columns: (m,) places of the joints in ``limits``.
        describe: where a segment is, for the error's text; takes its number and the next.

    Raises:
        InvalidTrajectoryError: they do not.
    """
    lower, upper, speed = limits.lower[columns], limits.upper[columns], limits.velocity[columns]
    fractions = np.linspace(0.0, 1.0, _SAMPLES)
    for first in range(0, len(duration), _CHUNK):
        with np.errstate(all="ignore"):
            position, velocity = _powers(duration[first : first + _CHUNK, None] * fractions)
            chunk = coefficients[first : first + _CHUNK]
            positions = position @ chunk  # (k, samples, m)
            speeds = np.abs(velocity @ chunk).max(axis=1)
        # Written so that NaN fails.
        if not (fast := speeds <= speed * SPEED_MARGIN).all():
            segment, joint = np.argwhere(~fast)[0]
            where = describe.format(first + segment, first + segment + 1)
            raise InvalidTrajectoryError(
                ErrorCode.INVALID_GOAL,
                f"{limits.names[columns[joint]]} would move at {speeds[segment, joint]:.3g} rad/s {where}; "
                f"its limit is {speed[joint]:g} rad/s",
            )
        inside = (positions >= lower - 1e-6) & (positions <= upper + 1e-6)
        if not inside.all():
            segment, _, joint = np.argwhere(~inside)[0]
            worst = positions[segment, :, joint]
            value = worst.max() if worst.max() > upper[joint] else worst.min()
            where = describe.format(first + segment, first + segment + 1)
            raise InvalidTrajectoryError(
                ErrorCode.INVALID_GOAL,
                f"{limits.names[columns[joint]]} would reach {value:.4g} rad {where}; "
                f"its limits are {lower[joint]:g} to {upper[joint]:g} rad",
            )


def _columns(names: Sequence[str], limits: JointLimits, allow_partial: bool) -> npt.NDArray[np.intp]:
    """Where the trajectory's joints stand in the controller's order."""

    def invalid(text: str) -> InvalidTrajectoryError:
        return InvalidTrajectoryError(ErrorCode.INVALID_JOINTS, text)

    if not names:
        raise invalid(f"no joint names; expected {', '.join(limits.names)}")
    place = {name: i for i, name in enumerate(limits.names)}
    if unknown := [name for name in names if name not in place]:
        raise invalid(f"unknown joint {unknown[0]!r}; the controller's joints are {', '.join(limits.names)}")
    if len(set(names)) != len(names):
        twice = next(name for i, name in enumerate(names) if name in names[:i])
        raise invalid(f"joint {twice!r} is named twice")
    if len(names) != len(limits.names) and not allow_partial:
        missing = ", ".join(name for name in limits.names if name not in names)
        raise invalid(f"joints missing: {missing} (allow_partial_joints_goal is false)")
    return np.array([place[name] for name in names], dtype=np.intp)


def check_waypoints(
    names: Sequence[str],
    points: Sequence[Point],
    limits: JointLimits,
    *,
    allow_partial: bool = False,
) -> Waypoints:
    """Check a trajectory as it came and lay splines through it.

    Raises:
        InvalidTrajectoryError: with the code and the text that the client gets.
    """
    columns = _columns(names, limits, allow_partial)

    def invalid(text: str) -> InvalidTrajectoryError:
        return InvalidTrajectoryError(ErrorCode.INVALID_GOAL, text)

    if not points:
        raise invalid("the trajectory has no points")
    k, m = len(points), len(columns)
    times = np.array([point.time_from_start for point in points])
    positions, velocities, accelerations = np.zeros((k, m)), np.zeros((k, m)), np.zeros((k, m))
    order = np.ones(k, dtype=np.intp)
    for i, point in enumerate(points):
        if len(point.effort):
            raise invalid(f"point {i} carries effort, which this controller does not command")
        for field, values, target in (
            ("positions", point.positions, positions),
            ("velocities", point.velocities, velocities),
            ("accelerations", point.accelerations, accelerations),
        ):
            if len(values) == 0 and field != "positions":
                continue
            if len(values) != m:
                raise invalid(f"point {i} has {len(values)} {field}; expected {m}, one a joint")
            target[i] = values
            if not np.isfinite(target[i]).all():
                joint = int(np.flatnonzero(~np.isfinite(target[i]))[0])
                raise invalid(f"point {i}: {field} of {names[joint]} is {target[i, joint]}; expected a finite number")
        if len(point.velocities):
            order[i] = 5 if len(point.accelerations) else 3
    if times[0] < 0:
        raise invalid(f"point 0 has time_from_start {times[0]:g} s; expected 0 or more")
    durations = np.diff(times)
    if not (durations > 0).all():
        i = int(np.flatnonzero(~(durations > 0))[0])
        raise invalid(
            f"time_from_start of point {i + 1} ({times[i + 1]:g} s) is not after that of point {i} ({times[i]:g} s)"
        )
    outside = (positions < limits.lower[columns]) | (positions > limits.upper[columns])
    if outside.any():
        i, joint = np.argwhere(outside)[0]
        column = columns[joint]
        raise invalid(
            f"point {i}: {names[joint]} at {positions[i, joint]:.4g} rad; "
            f"its limits are {limits.lower[column]:g} to {limits.upper[column]:g} rad"
        )
    fast = np.abs(velocities) > limits.velocity[columns] * SPEED_MARGIN
    if fast.any():
        i, joint = np.argwhere(fast)[0]
        raise invalid(
            f"point {i}: {names[joint]} at {velocities[i, joint]:.4g} rad/s; "
            f"its limit is {limits.velocity[columns[joint]]:g} rad/s"
        )
    if (np.abs(velocities[-1]) > _END_VELOCITY).any():
        joint = int(np.argmax(np.abs(velocities[-1])))
        raise invalid(f"{names[joint]} has {velocities[-1, joint]:.4g} rad/s at the last point; expected 0")
    coefficients = spline(
        (positions[:-1], velocities[:-1], accelerations[:-1]),
        (positions[1:], velocities[1:], accelerations[1:]),
        durations,
        np.minimum(order[:-1], order[1:]),
    )
    check_segments(coefficients, durations, limits, columns)
    return Waypoints(columns, times, positions, velocities, accelerations, order, coefficients)


class Trajectory:
    """A trajectory in execution, of all n joints of a controller, on robot time.

    Made in one of three ways: ``begin`` (way-points, from the present state), ``stopping`` (from motion to rest) and
    ``holding``. Past its end it stays at the last position.

    Attributes:
        end: robot time of the last point [ns].
    """

    def __init__(self, knots: Sequence[int], coefficients: Vector, final: Vector) -> None:
        """Take k segments.

        Args:
            knots: k + 1 robot times [ns].
            coefficients: (k, 6, n).
            final: (n,) where it ends [rad].
        """
        self._knots = list(knots)
        self._coefficients = coefficients
        self._final = final
        self._segment = 0
        self._matrix = np.zeros((3, 6))
        self._matrix[0, 0] = self._matrix[1, 1] = 1.0
        self._matrix[2, 2] = 2.0
        self.end = self._knots[-1]

    @classmethod
    def holding(cls, now: int, position: Vector) -> Trajectory:
        """Stay at a position."""
        return cls([now], np.zeros((0, 6, len(position))), position.copy())

    @classmethod
    def stopping(
        cls, now: int, position: Vector, velocity: Vector, deceleration: float, limits: JointLimits
    ) -> Trajectory:
        """Come to rest from ``velocity``, the fastest joint at ``deceleration`` [rad/s²], all in the same time."""
        duration = float(np.abs(velocity).max(initial=0.0)) / deceleration
        if duration < 1e-3:
            return cls.holding(now, position)
        final = np.clip(position + velocity * (duration / 2), limits.lower, limits.upper)
        rest = np.zeros((1, len(position)))
        coefficients = spline(
            (position[None], velocity[None], rest), (final[None], rest, rest), np.array([duration]), np.array([3])
        )
        return cls([now, now + round(duration * 1e9)], coefficients, final)

    @classmethod
    def begin(
        cls,
        waypoints: Waypoints,
        start: int,
        now: int,
        state: tuple[Vector, Vector, Vector],
        limits: JointLimits,
    ) -> Trajectory:
        """Go from the present set-point to the first point that is still to come, and on from there.

        Args:
            waypoints: checked.
            start: robot time at which the trajectory begins [ns]; 0: now.
            now: robot time [ns].
            state: (n,) position, velocity and acceleration commanded now; joints without way-points stay there.
            limits: of the controller's joints.

        Raises:
            InvalidTrajectoryError: it ended in the past, begins too far away for the speed limits, or with a jump.
        """
        stamped = start != 0
        start = start or now
        if start - now > LONGEST_WAIT * 1e9:
            raise InvalidTrajectoryError(
                ErrorCode.INVALID_GOAL,
                f"begins {(start - now) * 1e-9:.4g} s after now ({now * 1e-9:.3f} s of robot time); expected at most "
                f"{LONGEST_WAIT:g} s. Is the header stamped with another clock?",
            )
        columns = waypoints.columns
        times = start + np.rint(waypoints.times * 1e9).astype(np.int64)
        first = int(np.searchsorted(times, now, side="right"))
        if first == len(times):
            code = ErrorCode.OLD_HEADER_TIMESTAMP if stamped else ErrorCode.INVALID_GOAL
            late = (now - int(times[-1])) * 1e-9
            raise InvalidTrajectoryError(
                code, f"the trajectory ended {late:.3f} s ago" if stamped else "no time to reach the only point"
            )
        if not stamped and first == 1:
            # A point at time 0 says where the sender thinks that the robot is.
            distance = np.abs(waypoints.positions[0] - state[0][columns])
            if (distance > START_TOLERANCE).any():
                joint = int(np.argmax(distance))
                raise InvalidTrajectoryError(
                    ErrorCode.INVALID_GOAL,
                    f"{limits.names[columns[joint]]} is {distance[joint]:.3g} rad away from the first point, whose "
                    f"time_from_start is 0; expected at most {START_TOLERANCE:g} rad",
                )
        position, velocity, acceleration = (values[columns] for values in state)
        duration = np.array([(int(times[first]) - now) * 1e-9])
        opening = spline(
            (position[None], velocity[None], acceleration[None]),
            (waypoints.positions[first : first + 1], waypoints.velocities[first : first + 1],
             waypoints.accelerations[first : first + 1]),
            duration,
            waypoints.order[first : first + 1],
        )  # fmt: skip
        check_segments(opening, duration, limits, columns, f"between now and point {first}")
        segments = 1 + len(times) - 1 - first
        n = len(limits.names)
        coefficients = np.zeros((segments, 6, n))
        coefficients[:, 0] = state[0]
        coefficients[:1, :, columns] = opening
        coefficients[1:, :, columns] = waypoints.coefficients[first:]
        final = state[0].copy()
        final[columns] = waypoints.positions[-1]
        return cls([now, *times[first:].tolist()], coefficients, final)

    def sample(self, now: int, position: Vector, velocity: Vector, acceleration: Vector) -> None:
        """Write the state at a robot time [ns] into three (n,) vectors. Time does not run backwards."""
        knots = self._knots
        if now >= self.end:
            position[:] = self._final
            velocity.fill(0.0)
            acceleration.fill(0.0)
            return
        segment = self._segment
        while now >= knots[segment + 1]:
            segment += 1
        self._segment = segment
        t = max(0, now - knots[segment]) * 1e-9
        t2 = t * t
        t3 = t2 * t
        m = self._matrix
        m[0, 1:] = t, t2, t3, t2 * t2, t2 * t3
        m[1, 2:] = 2 * t, 3 * t2, 4 * t3, 5 * t2 * t2
        m[2, 3:] = 6 * t, 12 * t2, 20 * t3
        position[:], velocity[:], acceleration[:] = m @ self._coefficients[segment]

    def delay(self, by: int) -> None:
        """Put off what is still to come by a time [ns]."""
        self._knots = [knot + by for knot in self._knots]
        self.end += by
