"""How far from the desired state a robot may be, on the way and at the goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits


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

    def violation(self, limits: CommandedLimits, position_error: FloatArray, velocity_error: FloatArray) -> str:
        """Which joint is out, by how much, and the tolerance; empty: none."""
        for error, tolerance, per in ((position_error, self.position, ""), (velocity_error, self.velocity, "/s")):
            off = np.abs(error)
            if (off > tolerance).any():
                joint = int(np.argmax(off / tolerance))
                unit = limits.units[joint] + per
                return f"{limits.names[joint]} is {error[joint]:+.3f} {unit} off; tolerance {tolerance[joint]:g} {unit}"
        return ""
