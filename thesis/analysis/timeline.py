"""Goals that an experiment sent, with times: a file beside the bag, which does not contain goals of actions."""

from __future__ import annotations

import msgspec
import numpy as np

from thesis.stored import Stored
from valor.common.arrays import FloatArray

SETTLED = 0.3  # end of a motion over which final errors are averaged [s]


class Motion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One goal of a trajectory controller."""

    name: str
    start: float  # robot time of sending [s]
    end: float  # robot time when the robot was at rest again [s]
    goal: dict[str, float]  # final positions by joint [rad]

    @property
    def rest(self) -> tuple[float, float]:
        """Interval at rest after it, robot time [s]."""
        return self.end - SETTLED, self.end


class Timeline(Stored, frozen=True, forbid_unknown_fields=True):
    """The motions of an experiment, in order."""

    motions: list[Motion]

    def reference(self, joint: str, times: FloatArray) -> FloatArray:
        """(m,) last goal of a joint [rad] at each of some times (m,) [s]; NaN before its first."""
        made = np.full(len(times), np.nan)
        for motion in self.motions:
            if joint in motion.goal:
                made[times >= motion.start] = motion.goal[joint]
        return made
