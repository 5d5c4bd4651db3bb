"""What an experiment asked of the robot, and when: kept beside the bag, for goals of actions are not in it."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from valor.analysis import json_file
from valor.bags.errors import BagError
from valor.common.arrays import FloatArray

SETTLED = 0.3  # at a motion's end, over which final errors are averaged [s]


class Motion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One goal of a trajectory controller."""

    name: str
    start: float  # when it was sent, robot time [s]
    end: float  # when the robot had come to rest after it, robot time [s]
    goal: dict[str, float]  # final positions by joint [rad]

    @property
    def rest(self) -> tuple[float, float]:
        """From when to when the robot is at rest after it [s]."""
        return self.end - SETTLED, self.end


class Timeline(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The motions of an experiment, in the order in which they were made."""

    motions: list[Motion]

    @classmethod
    def load(cls, file: Path) -> Timeline:
        """Read one.

        Raises:
            BagError: it cannot be read, or is none.
        """
        return json_file.load(file, cls, BagError, "the experiment's motions")

    def save(self, file: Path) -> Path:
        """Write it; returns the file."""
        return json_file.save(self, file)

    def reference(self, joint: str, times: FloatArray) -> FloatArray:
        """(m,) the last goal that a joint was given before each of some times [s]; NaN before its first."""
        made = np.full(len(times), np.nan)
        for motion in self.motions:
            if joint in motion.goal:
                made[times >= motion.start] = motion.goal[joint]
        return made
