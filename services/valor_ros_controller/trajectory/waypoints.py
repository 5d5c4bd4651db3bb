"""Way-points as they come, checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits, Indices
from valor.valor_ros_controller.trajectory.errors import ErrorCode, InvalidTrajectoryError
from valor.valor_ros_controller.trajectory.splines import check_segments, spline

_END_VELOCITY = 1e-6  # [1/s]


@dataclass(frozen=True)
class Point:
    """A way-point as it came: sequences have one entry a joint, or none."""

    positions: Sequence[float]  # [rad or m]
    velocities: Sequence[float]  # [1/s]
    accelerations: Sequence[float]  # [1/s²]
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
        speed: (m,) greatest between the points [1/s].
        acceleration: (m,) likewise [1/s²]; inf: velocities jump.
    """

    columns: Indices
    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    order: Indices
    coefficients: FloatArray
    speed: FloatArray
    acceleration: FloatArray


def _columns(names: Sequence[str], limits: CommandedLimits, allow_partial: bool) -> Indices:
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
    limits: CommandedLimits,
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
    limits = limits.select(columns)
    outside = positions != limits.position_within(positions)
    if outside.any():
        i, joint = np.argwhere(outside)[0]
        unit = limits.units[joint]
        raise invalid(
            f"point {i}: {names[joint]} at {positions[i, joint]:.4g} {unit}; "
            f"its limits are {limits.lower[joint]:g} to {limits.upper[joint]:g} {unit}"
        )
    fast = np.abs(velocities) > limits.fastest
    if fast.any():
        i, joint = np.argwhere(fast)[0]
        unit = limits.units[joint]
        raise invalid(
            f"point {i}: {names[joint]} at {velocities[i, joint]:.4g} {unit}/s; "
            f"its limit is {limits.velocity[joint]:g} {unit}/s"
        )
    if (np.abs(velocities[-1]) > _END_VELOCITY).any():
        joint = int(np.argmax(np.abs(velocities[-1])))
        raise invalid(
            f"{names[joint]} has {velocities[-1, joint]:.4g} {limits.units[joint]}/s at the last point; expected 0"
        )
    coefficients = spline(
        (positions[:-1], velocities[:-1], accelerations[:-1]),
        (positions[1:], velocities[1:], accelerations[1:]),
        durations,
        np.minimum(order[:-1], order[1:]),
    )
    speed, acceleration = check_segments(coefficients, durations, limits)
    if (order == 1).any():
        acceleration = np.full(m, np.inf)
    return Waypoints(columns, times, positions, velocities, accelerations, order, coefficients, speed, acceleration)
