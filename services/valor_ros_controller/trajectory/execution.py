"""A trajectory in execution."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits
from valor.valor_ros_controller.trajectory.errors import ErrorCode, InvalidTrajectoryError
from valor.valor_ros_controller.trajectory.splines import check_segments, spline
from valor.valor_ros_controller.trajectory.waypoints import Waypoints

START_TOLERANCE = 0.1
"""How far a point at time 0 may be from the present set-point [rad or m]: it tells where the sender thinks we are."""
LONGEST_WAIT = 600.0
"""A trajectory may not begin later than this [s]: a later one is stamped with another clock."""


class Trajectory:
    """A trajectory in execution, of all n joints of a controller, on robot time.

    Made in one of three ways: ``begin`` (way-points, from the present state), ``stopping`` (from motion to rest) and
    ``holding``. Past its end it stays at the last position.

    Attributes:
        start: robot time at which it was made [ns].
        end: robot time of the last point [ns].
    """

    def __init__(self, knots: Sequence[int], coefficients: FloatArray, final: FloatArray) -> None:
        """Take k segments.

        Args:
            knots: k + 1 robot times [ns].
            coefficients: (k, 6, n).
            final: (n,) where it ends [rad or m].
        """
        self._knots = list(knots)
        self._coefficients = coefficients
        self._final = final
        self._segment = 0
        self._matrix = np.zeros((3, 6))
        self._matrix[0, 0] = self._matrix[1, 1] = 1.0
        self._matrix[2, 2] = 2.0
        self.start, self.end = self._knots[0], self._knots[-1]

    @classmethod
    def holding(cls, now: int, position: FloatArray) -> Trajectory:
        """Stay at a position."""
        return cls([now], np.zeros((0, 6, len(position))), position.copy())

    @classmethod
    def stopping(
        cls, now: int, position: FloatArray, velocity: FloatArray, deceleration: FloatArray, limits: CommandedLimits
    ) -> Trajectory:
        """Come to rest from ``velocity`` (n,), each joint with its own ``deceleration`` (n,) [1/s²].

        A joint that would pass its limit decelerates harder, so as to stop at it.
        """
        room = np.where(velocity > 0.0, limits.upper - position, position - limits.lower)
        room = np.maximum(room, 1e-9)
        speed = np.abs(velocity)
        deceleration = np.maximum(deceleration, speed**2 / (2.0 * room))
        duration = speed / deceleration
        rests = np.unique(np.rint(duration * 1e9).astype(np.int64))
        knots = np.concatenate(([0], rests[rests > 0]))
        # Between two joints' coming to rest all accelerations are constant.
        begin = np.minimum(knots[:-1, None] * 1e-9, duration)  # (k, n) how long each has decelerated
        sign = np.sign(velocity)
        rate = velocity - sign * deceleration * begin
        coefficients = np.zeros((len(knots) - 1, 6, len(position)))
        coefficients[:, 0] = position + (velocity + rate) * (0.5 * begin)
        moving = begin < duration - 1e-9
        coefficients[:, 1] = moving * rate
        coefficients[:, 2] = moving * (-0.5 * sign * deceleration)
        final = limits.position_within(position + velocity * (0.5 * duration))
        return cls((now + knots).tolist(), coefficients, final)

    @classmethod
    def begin(
        cls,
        waypoints: Waypoints,
        start: int,
        now: int,
        state: tuple[FloatArray, FloatArray, FloatArray],
        limits: CommandedLimits,
        *,
        error: FloatArray | None = None,
    ) -> Trajectory:
        """Go from the present set-point to the first point that is still to come, and on from there.

        Args:
            waypoints: checked.
            start: robot time at which the trajectory begins [ns]; 0: now.
            now: robot time [ns].
            state: (n,) position, velocity and acceleration commanded now; joints without way-points stay there.
            limits: of the controller's joints.
            error: (n,) to within which what has these limits shall follow; None: to within any.

        Raises:
            InvalidTrajectoryError: it ended in the past, begins too far away for the speed limits or with a jump, or
                is too jerky for its speed.
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
                    f"{limits.names[columns[joint]]} is {distance[joint]:.3g} {limits.units[columns[joint]]} away from "
                    f"the first point, whose time_from_start is 0; expected at most {START_TOLERANCE:g}",
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
        moving = limits.select(columns)
        speed, acceleration = check_segments(opening, duration, moving, f"between now and point {first}")
        _check_jumps(
            np.maximum(speed, waypoints.speed),
            np.maximum(acceleration, waypoints.acceleration),
            moving,
            error if error is None else error[columns],
        )
        segments = 1 + len(times) - 1 - first
        n = len(limits.names)
        coefficients = np.zeros((segments, 6, n))
        coefficients[:, 0] = state[0]
        coefficients[:1, :, columns] = opening
        coefficients[1:, :, columns] = waypoints.coefficients[first:]
        final = state[0].copy()
        final[columns] = waypoints.positions[-1]
        return cls([now, *times[first:].tolist()], coefficients, final)

    def sample(self, now: int, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> None:
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
        self._evaluate(segment, now, (position, velocity, acceleration))

    def at(self, time: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(n,) position, velocity and acceleration at any robot time [ns]; before its start as at its start."""
        n = len(self._final)
        if time >= self.end:
            return self._final.copy(), np.zeros(n), np.zeros(n)
        state = (np.empty(n), np.empty(n), np.empty(n))
        segment = max(0, bisect_right(self._knots, time) - 1)
        self._evaluate(segment, time, state)
        return state

    def _evaluate(self, segment: int, time: int, state: tuple[FloatArray, FloatArray, FloatArray]) -> None:
        t = max(0, time - self._knots[segment]) * 1e-9
        t2 = t * t
        t3 = t2 * t
        m = self._matrix
        m[0, 1:] = t, t2, t3, t2 * t2, t2 * t3
        m[1, 2:] = 2 * t, 3 * t2, 4 * t3, 5 * t2 * t2
        m[2, 3:] = 6 * t, 12 * t2, 20 * t3
        state[0][:], state[1][:], state[2][:] = m @ self._coefficients[segment]

    def delay(self, by: int) -> None:
        """Put off what is still to come by a time [ns]."""
        self._knots = [knot + by for knot in self._knots]
        self.start, self.end = self._knots[0], self._knots[-1]


def _check_jumps(
    speed: FloatArray, acceleration: FloatArray, limits: CommandedLimits, error: FloatArray | None
) -> None:
    """Whether a trajectory with these greatest speeds and accelerations (m,) can be followed to within (m,) errors.

    Raises:
        InvalidTrajectoryError: it cannot.
    """
    if error is None:
        return
    highest = limits.jumping_velocity(error)
    jerky = (acceleration > limits.acceleration) & (speed > highest)
    if jerky.any():
        joint = int(np.argmax(jerky))
        unit = limits.units[joint]
        raise InvalidTrajectoryError(
            ErrorCode.INVALID_GOAL,
            f"{limits.names[joint]} would move at {speed[joint]:.3g} {unit}/s with jumps of its velocity, or with more "
            f"than {limits.acceleration[joint]:g} {unit}/s²; its limit is then {highest[joint]:.3g} {unit}/s, so that "
            f"the path tolerance of {error[joint]:g} {unit} can be kept",
        )
