"""How far from the desired state a robot may be, on the way and at the goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits
from valor.valor_ros_controller.trajectory.errors import ErrorCode, InvalidTrajectoryError


@dataclass(frozen=True)
class Tolerances:
    """How far from the desired state each of n joints may be; inf: not checked."""

    position: FloatArray  # (n,) [rad or m]
    velocity: FloatArray  # (n,) [1/s]

    @classmethod
    def default(cls, position: Sequence[float], velocity: float) -> Tolerances:
        """(n,) of positions and one of velocity; 0: not checked."""
        return cls(
            np.array([value or np.inf for value in position]),
            np.full(len(position), velocity or np.inf),
        )

    def override(self, entries: Sequence[tuple[str, float, float]], names: Sequence[str], which: str) -> Tolerances:
        """Take what a goal states: (joint, position, velocity); 0: keep the default, -1: not checked.

        Raises:
            InvalidTrajectoryError: an unknown joint, or a number that is none of these.
        """
        if not entries:
            return self
        position, velocity = self.position.copy(), self.velocity.copy()
        for name, *values in entries:
            if name not in names:
                raise InvalidTrajectoryError(
                    ErrorCode.INVALID_GOAL, f"{which} names {name!r}, which is none of {', '.join(names)}"
                )
            joint = names.index(name)
            for field, target, value in zip(("position", "velocity"), (position, velocity), values, strict=True):
                if not np.isfinite(value) or (value < 0 and value != -1):
                    raise InvalidTrajectoryError(
                        ErrorCode.INVALID_GOAL,
                        f"{which} of {name}: {field} is {value:g}; expected positive, 0 (default) or -1 (unchecked)",
                    )
                if value:
                    target[joint] = np.inf if value < 0 else value
        return Tolerances(position, velocity)

    def violation(self, limits: CommandedLimits, position_error: FloatArray, velocity_error: FloatArray) -> str:
        """Which joint is out, by how much, and the tolerance; empty: none."""
        for error, tolerance, per in ((position_error, self.position, ""), (velocity_error, self.velocity, "/s")):
            off = np.abs(error)
            if (off > tolerance).any():
                joint = int(np.argmax(off / tolerance))
                unit = limits.units[joint] + per
                return f"{limits.names[joint]} is {error[joint]:+.3f} {unit} off; tolerance {tolerance[joint]:g} {unit}"
        return ""
