"""How joints that were out of reach come back: from where they are, not from where they should have been."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray

SPEED = 0.5  # towards the wanted position [rad/s]
_THERE = 1e-3  # [rad]


class Rejoining:
    """Set-points of k joints: those wanted, except while joints are out, and on their way back.

    Attributes:
        position: (k,) set-points of the last cycle [rad].
        out: (k,) joints that cannot be reached.
        returning: (k,) joints that are on their way from where they were found.
    """

    def __init__(self, count: int) -> None:
        self.position = np.zeros(count)
        self.out = np.ones(count, dtype=bool)
        self.returning = np.zeros(count, dtype=bool)

    def heard(self, measured: FloatArray, reachable: npt.NDArray[np.bool_]) -> None:
        """Where the joints are [rad], and which can be reached: those that were out return from there."""
        back = self.out & reachable
        if back.any():
            self.position[back] = measured[back]
            self.returning |= back
        self.out = ~reachable
        self.returning &= reachable

    def lost(self) -> None:
        """No joint can be reached."""
        self.out[:] = True
        self.returning[:] = False

    def advance(self, wanted: FloatArray, period: float) -> FloatArray:
        """(k,) the set-points after ``period`` [s], towards those wanted [rad]; of joints that are out the last."""
        if self.returning.any() or self.out.any():
            step = np.clip(wanted - self.position, -SPEED * period, SPEED * period)
            self.position = np.where(self.returning, self.position + step, np.where(self.out, self.position, wanted))
            self.returning &= np.abs(wanted - self.position) > _THERE
        else:
            self.position = wanted.copy()
        return self.position.copy()
