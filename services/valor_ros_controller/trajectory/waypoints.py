"""Way-points, as they come and checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import Indices


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
        states: (3, k, m) positions, velocities and accelerations; 0 where a point has none.
        order: (k,) what each point carries: 1 positions, 3 also velocities, 5 also accelerations.
        coefficients: (k-1, 6, m) of the splines between the points, lowest power first.
        speed: (m,) greatest between the points [1/s].
        acceleration: (m,) likewise [1/s²]; inf: velocities jump.
    """

    columns: Indices
    times: FloatArray
    states: FloatArray
    order: Indices
    coefficients: FloatArray
    speed: FloatArray
    acceleration: FloatArray
