"""Admission of trajectories: checks of way-points, and the way from the set-point to the first one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits, Indices
from valor.valor_ros_controller.trajectory.execution import Trajectory
from valor.valor_ros_controller.trajectory.splines import sampled, spline
from valor.valor_ros_controller.trajectory.waypoints import ErrorCode, InvalidTrajectoryError, Point, Waypoints

START_TOLERANCE = 0.1  # distance of a point at time 0, the sender's assumed position, from the set-point [rad or m]
LONGEST_WAIT = 600.0  # until a trajectory begins; a later one is stamped with another clock [s]
_END_VELOCITY = 1e-6  # [1/s]
_JOINS = (0.1, 0.2, 0.4)  # times at which dense trajectories that begin beside the set-point may be joined [s]
_DELAYS = (0.0, 0.1, 0.3, 1.0)  # fractions of the allowed delay, tried in order


def _range(limits: CommandedLimits, joint: int) -> str:
    return f"its limits are {limits.lower[joint]:g} to {limits.upper[joint]:g} {limits.units[joint]}"


def _speed(limits: CommandedLimits, joint: int) -> str:
    return f"its limit is {limits.velocity[joint]:g} {limits.units[joint]}/s"


# --- way-points -------------------------------------------------------------------------------------------------------


def check_waypoints(
    names: Sequence[str],
    points: Sequence[Point],
    limits: CommandedLimits,
    *,
    allow_partial: bool = False,
    at_rest: bool = True,
) -> Waypoints:
    """Check a received trajectory and lay splines through it; ``at_rest``: it must end at rest.

    Raises:
        InvalidTrajectoryError: with code and text for the client.
    """
    columns = _columns(names, limits, allow_partial)
    if not points:
        raise InvalidTrajectoryError("the trajectory has no points")
    states, order = _states(names, points)
    times = _times(points)
    limits = limits.select(columns)
    _check_states(states, limits)
    if at_rest:
        _check_end(states[1, -1], limits)
    durations = np.diff(times)
    coefficients = spline(states[:, :-1], states[:, 1:], durations, np.minimum(order[:-1], order[1:]))
    speed, acceleration = _check_segments(coefficients, durations, limits)
    if (order == 1).any():
        acceleration = np.full(len(columns), np.inf)
    return Waypoints(columns, times, states, order, coefficients, speed, acceleration)


def _columns(names: Sequence[str], limits: CommandedLimits, allow_partial: bool) -> Indices:
    """Indices of the trajectory's joints in the controller's order."""
    index = {name: i for i, name in enumerate(limits.names)}
    if not names:
        text = f"no joint names; expected {', '.join(limits.names)}"
    elif unknown := [name for name in names if name not in index]:
        text = f"unknown joint {unknown[0]!r}; the controller's joints are {', '.join(limits.names)}"
    elif twice := [name for i, name in enumerate(names) if name in names[:i]]:
        text = f"joint {twice[0]!r} is named twice"
    elif not allow_partial and (missing := [name for name in limits.names if name not in names]):
        text = f"joints missing: {', '.join(missing)} (allow_partial_joints_goal is false)"
    else:
        return np.array([index[name] for name in names], dtype=np.intp)
    raise InvalidTrajectoryError(text, ErrorCode.INVALID_JOINTS)


def _states(names: Sequence[str], points: Sequence[Point]) -> tuple[FloatArray, Indices]:
    """``states`` and ``order`` of ``Waypoints``."""
    m = len(names)
    states, order = np.zeros((3, len(points), m)), np.ones(len(points), dtype=np.intp)
    for i, point in enumerate(points):
        if len(point.effort):
            raise InvalidTrajectoryError(f"point {i} carries effort, which this controller does not command")
        for field, target in zip(("positions", "velocities", "accelerations"), states[:, i], strict=True):
            values = getattr(point, field)
            if len(values) == 0 and field != "positions":
                continue
            if len(values) != m:
                raise InvalidTrajectoryError(f"point {i} has {len(values)} {field}; expected {m}, one per joint")
            target[:] = values
            if not (finite := np.isfinite(target)).all():
                joint = int(np.argmin(finite))
                raise InvalidTrajectoryError(
                    f"point {i}: {field} of {names[joint]} is {target[joint]}; expected a finite number"
                )
        if len(point.velocities):
            order[i] = 5 if len(point.accelerations) else 3
    return states, order


def _times(points: Sequence[Point]) -> FloatArray:
    """Times of the points (k,), increasing [s]."""
    times = np.array([point.time_from_start for point in points])
    if times[0] < 0:
        raise InvalidTrajectoryError(f"point 0 has time_from_start {times[0]:g} s; expected 0 or more")
    later = np.diff(times) > 0
    if not later.all():
        i = int(np.argmin(later))
        raise InvalidTrajectoryError(
            f"time_from_start of point {i + 1} ({times[i + 1]:g} s) is not after that of point {i} ({times[i]:g} s)"
        )
    return times


def _check_states(states: FloatArray, limits: CommandedLimits) -> None:
    """Check the points against the limits."""
    positions, velocities, _ = states
    for values, outside, per, limit in (
        (positions, positions != limits.position_within(positions), "", _range),
        (velocities, np.abs(velocities) > limits.fastest, "/s", _speed),
    ):
        if outside.any():
            i, joint = np.argwhere(outside)[0]
            value = f"{values[i, joint]:.4g} {limits.units[joint]}{per}"
            raise InvalidTrajectoryError(f"point {i}: {limits.names[joint]} at {value}; {limit(limits, joint)}")


def _check_end(velocity: FloatArray, limits: CommandedLimits) -> None:
    """Check that the last point is at rest."""
    if (np.abs(velocity) > _END_VELOCITY).any():
        joint = int(np.argmax(np.abs(velocity)))
        value = f"{velocity[joint]:.4g} {limits.units[joint]}/s"
        raise InvalidTrajectoryError(f"{limits.names[joint]} has {value} at the last point; expected 0")


def _check_segments(
    coefficients: FloatArray,
    duration: FloatArray,
    limits: CommandedLimits,
    where: str = "between points {0} and {1}",
) -> tuple[FloatArray, FloatArray]:
    """Check splines (k, 6, m) of durations (k,) [s] against the limits of position and speed.

    Returns (m,) maximum speed [1/s] and acceleration [1/s²] of each joint. ``where``: text of an error, with fields for
    the numbers of a segment and the next.
    """
    most = np.zeros((2, len(limits.names)))
    for first, positions, speeds, accelerations in sampled(coefficients, duration):
        # Also rejects NaN.
        if not (slow := speeds <= limits.fastest).all():
            segment, joint = np.argwhere(~slow)[0]
            value = f"move at {np.nan_to_num(speeds[segment, joint], nan=np.inf):.3g} {limits.units[joint]}/s"
            limit = _speed(limits, joint)
        elif not (inside := (positions >= limits.lower - 1e-6) & (positions <= limits.upper + 1e-6)).all():
            segment, _, joint = np.argwhere(~inside)[0]
            reached = positions[segment, :, joint]
            farthest = reached.max() if reached.max() > limits.upper[joint] else reached.min()
            value = f"reach {farthest:.4g} {limits.units[joint]}"
            limit = _range(limits, joint)
        else:
            most = np.maximum(most, [speeds.max(axis=0), accelerations.max(axis=0)])
            continue
        place = where.format(first + segment, first + segment + 1)
        raise InvalidTrajectoryError(f"{limits.names[joint]} would {value} {place}; {limit}")
    return most[0], most[1]


# --- start ------------------------------------------------------------------------------------------------------------


def begin(
    waypoints: Waypoints,
    start: int,
    now: int,
    state: FloatArray,
    limits: CommandedLimits,
    *,
    since: int,
    error: FloatArray | None = None,
    late: float = 0.0,
) -> Trajectory:
    """Trajectory from the set-point to the first future point, and on from there.

    Args:
        waypoints: checked.
        start: robot time of the trajectory's start [ns]; 0: now.
        now: robot time [ns], from which ``time_from_start`` counts unless stamped.
        state: (3, n) position, velocity and acceleration commanded last; joints without way-points stay.
        limits: of the controller's joints.
        since: robot time of ``state`` [ns], where the trajectory begins. Replaced in every cycle it still advances.
        error: (n,) within which the limited set-point must follow [rad or m]; None: unlimited.
        late: allowed delay of the points if the first is too far away for its time [s].

    Raises:
        InvalidTrajectoryError: it ended in the past, begins too far away for the speed limits or with a jump, or has
            jumps that the limiter cannot follow.
    """
    columns = waypoints.columns
    present, moving = state[:, columns], limits.select(columns)
    times = (start or now) + np.rint(waypoints.times * 1e9).astype(np.int64)
    first = _next_point(times, start, now)
    if not start and first == 1:
        _check_start(waypoints.states[0, 0], present[0], moving)
    joins = [first] if start or first != 1 else _joins(times, now)
    within = None if error is None else error[columns]
    first, delay, opening = _join(waypoints, times - since, joins, present, moving, late=late, error=within)
    times += delay
    coefficients = np.zeros((len(times) - first, 6, len(limits.names)))
    coefficients[:, 0] = state[0]
    coefficients[:, :, columns] = np.concatenate((opening, waypoints.coefficients[first:]))
    final = state[0].copy()
    final[columns] = waypoints.states[0, -1]
    return Trajectory([since, *times[first:].tolist()], coefficients, final)


def _joins(times: Indices, now: int) -> list[int]:
    """Points at which to join a trajectory that begins beside the set-point: the next, then later ones."""
    later = np.searchsorted(times, now + np.rint(np.array(_JOINS) * 1e9))
    return list(dict.fromkeys([1, *np.minimum(later, len(times) - 1).tolist()]))


def _join(
    waypoints: Waypoints,
    times: Indices,
    joins: list[int],
    present: FloatArray,
    limits: CommandedLimits,
    *,
    late: float,
    error: FloatArray | None,
) -> tuple[int, int, FloatArray]:
    """First of the points ``joins`` that can be reached in ``times`` [ns].

    Returns its index; delay [ns]; (1, 6, m) coefficients of the way there.
    """
    rejections = []
    for join in joins:
        try:
            delay, opening, speed, acceleration = _opening(
                waypoints, join, int(times[join]), present, limits, late=late
            )
            if error is not None:
                fastest = np.maximum(speed, waypoints.speed)
                _check_jumps(fastest, np.maximum(acceleration, waypoints.acceleration), limits, error)
        except InvalidTrajectoryError as rejection:
            rejections.append(rejection)
        else:
            return join, delay, opening
    raise rejections[0]


def _opening(
    waypoints: Waypoints, first: int, time: int, present: FloatArray, limits: CommandedLimits, *, late: float
) -> tuple[int, FloatArray, FloatArray, FloatArray]:
    """Segment that reaches point ``first`` in ``time`` [ns], or with the smallest possible delay.

    Returns delay [ns]; (1, 6, m) coefficients; (m,) maximum speed and acceleration.
    """
    following = slice(first, first + 1)
    delays = [round(late * 1e9 * part) for part in _DELAYS] if late else [0]
    for delay in delays:
        duration = np.array([(time + delay) * 1e-9])
        opening = spline(present[:, None], waypoints.states[:, following], duration, waypoints.order[following])
        try:
            return delay, opening, *_check_segments(opening, duration, limits, f"between now and point {first}")
        except InvalidTrajectoryError:
            if delay == delays[-1]:
                raise
    raise AssertionError("the last delay returns or raises")


def _next_point(times: Indices, start: int, now: int) -> int:
    """First point after now."""
    if start - now > LONGEST_WAIT * 1e9:
        raise InvalidTrajectoryError(
            f"begins {(start - now) * 1e-9:.4g} s after now ({now * 1e-9:.3f} s of robot time); expected at most "
            f"{LONGEST_WAIT:g} s. Is the header stamped with another clock?"
        )
    first = int(np.searchsorted(times, now, side="right"))
    if first < len(times):
        return first
    if start:
        late = (now - int(times[-1])) * 1e-9
        raise InvalidTrajectoryError(f"the trajectory ended {late:.3f} s ago", ErrorCode.OLD_HEADER_TIMESTAMP)
    raise InvalidTrajectoryError("no time to reach the only point")


def _check_start(point: FloatArray, position: FloatArray, limits: CommandedLimits) -> None:
    """Check a point (m,) at time 0, the sender's assumed position."""
    distance = np.abs(point - position)
    if (distance > START_TOLERANCE).any():
        joint = int(np.argmax(distance))
        raise InvalidTrajectoryError(
            f"{limits.names[joint]} is {distance[joint]:.3g} {limits.units[joint]} away from the first point, whose "
            f"time_from_start is 0; expected at most {START_TOLERANCE:g}"
        )


def _check_jumps(speed: FloatArray, acceleration: FloatArray, limits: CommandedLimits, error: FloatArray) -> None:
    """Check that a trajectory with maximum speeds and accelerations (m,) can be followed within errors (m,)."""
    highest = limits.jumping_velocity(error)
    jerky = (acceleration > limits.acceleration) & (speed > highest)
    if jerky.any():
        joint = int(np.argmax(jerky))
        unit = limits.units[joint]
        raise InvalidTrajectoryError(
            f"{limits.names[joint]} would move at {speed[joint]:.3g} {unit}/s with jumps of its velocity, or with more "
            f"than {limits.acceleration[joint]:g} {unit}/s²; its limit is then {highest[joint]:.3g} {unit}/s, so that "
            f"the path tolerance of {error[joint]:g} {unit} can be kept"
        )
