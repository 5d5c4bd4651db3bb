"""Way-points as received and as checked, tolerances, and errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits, Indices


class ErrorCode(IntEnum):
    """Values of ``control_msgs/action/FollowJointTrajectory``."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class InvalidTrajectoryError(ValueError):
    """Rejected trajectory; the text names the joint, the value and the limit."""

    def __init__(self, text: str, code: ErrorCode = ErrorCode.INVALID_GOAL) -> None:
        super().__init__(text)
        self.code = code


@dataclass(frozen=True)
class Point:
    """Way-point as received; sequences have one entry per joint, or none."""

    positions: Sequence[float]  # [rad or m]
    velocities: Sequence[float]  # [1/s]
    accelerations: Sequence[float]  # [1/s²]
    effort: Sequence[float]  # [N·m]
    time_from_start: float  # [s]


@dataclass(frozen=True)
class Waypoints:
    """Checked trajectory of k points of m joints."""

    columns: Indices  # (m,) indices of the joints in the controller's order
    times: FloatArray  # (k,) from the start of the trajectory, increasing [s]
    states: FloatArray  # (3, k, m) positions, velocities and accelerations; 0 where a point has none
    order: Indices  # (k,) 1: the point has positions; 3: also velocities; 5: also accelerations
    coefficients: FloatArray  # (k-1, 6, m) of the splines between the points, lowest power first
    speed: FloatArray  # (m,) maximum between the points [1/s]
    acceleration: FloatArray  # (m,) maximum between the points [1/s²]; inf: velocities jump


@dataclass(frozen=True)
class Tolerances:
    """Largest allowed deviation from the desired state of each of n joints; inf: not checked."""

    position: FloatArray  # (n,) [rad or m]
    velocity: FloatArray  # (n,) [1/s]

    @classmethod
    def default(cls, position: Sequence[float], velocity: float) -> Tolerances:
        """Tolerances of n positions, and one of all velocities; 0: not checked."""
        return cls(np.array([value or np.inf for value in position]), np.full(len(position), velocity or np.inf))

    def violation(self, limits: CommandedLimits, position_error: FloatArray, velocity_error: FloatArray) -> str:
        """Joint out of tolerance, its error and the tolerance; empty if there is none."""
        for error, tolerance, per in ((position_error, self.position, ""), (velocity_error, self.velocity, "/s")):
            off = np.abs(error)
            if (off > tolerance).any():
                joint = int(np.argmax(off / tolerance))
                unit = limits.units[joint] + per
                return f"{limits.names[joint]} is {error[joint]:+.3f} {unit} off; tolerance {tolerance[joint]:g} {unit}"
        return ""
