"""Velocity of a target that a client streams as successive goals, as of a headset."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

import numpy as np

from valor.common import rotation
from valor.common.arrays import FloatArray

LONGEST_GAP = 0.25  # between two goals of a stream [s]
JUMP = np.array((0.05, 0.3))  # between them, beyond which the later one is a goal on its own [m, rad]
STILL = np.array((0.002, 0.01))  # speeds below which a target stands, as of repeated goals [m/s, rad/s]
AVERAGED = 0.05  # time constant of the average of motion and intervals [s]
OVERDUE = 2.0  # time without another goal after which a stream has stopped, in average intervals
SHORTEST = 0.02  # such a time [s]


@dataclass(frozen=True, slots=True)
class HandGoal:
    """Target pose of a hand."""

    in_odom: bool  # else in pelvis
    position: FloatArray  # (3,) [m]
    rotation: FloatArray  # (3, 3)


class GoalStream:
    """The goals of one hand since it began to move on. Times are robot time [s]."""

    def __init__(self, speeds: FloatArray) -> None:
        """``speeds`` are the largest ones (2,) of the target [m/s, rad/s]."""
        self._speeds = speeds
        self.clear()

    def clear(self) -> None:
        """The next goal is a goal on its own."""
        self._last: HandGoal | None = None
        self._received = self._until = -np.inf
        self._motion, self._interval, self._goals = np.zeros(6), 0.0, 0.0  # exponentially weighted sums
        self._twist = np.zeros(6)

    def add(self, goal: HandGoal, now: float) -> None:
        """Take a goal into account."""
        last, interval = self._last or goal, now - self._received
        turn = rotation.rotation_vector(goal.rotation @ last.rotation.T)
        motion = np.concatenate((goal.position - last.position, turn))
        if goal.in_odom != last.in_odom or not 0.0 <= interval <= LONGEST_GAP or (_norms(motion) > JUMP).any():
            self.clear()
        else:
            kept = exp(-interval / AVERAGED)
            self._motion, self._interval = kept * self._motion + motion, kept * self._interval + interval
            self._goals = kept * self._goals + 1.0
            twist = self._motion / max(self._interval, 1e-3)
            speeds = _norms(twist)
            self._twist = twist * ((speeds > STILL).any() / np.repeat(np.maximum(1.0, speeds / self._speeds), 3))
            self._until = now + max(SHORTEST, OVERDUE * self._interval / self._goals)
        self._last, self._received = goal, now

    def at(self, goal: HandGoal, now: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position (3,) [m], rotation (3, 3) and twist (6,) of the target; a stopped stream's is its last goal."""
        if now >= self._until or not self._twist.any():
            return goal.position, goal.rotation, np.zeros(6)
        ahead = (now - self._received) * self._twist
        return goal.position + ahead[:3], rotation.from_rotation_vector(ahead[3:]) @ goal.rotation, self._twist


def _norms(twist: FloatArray) -> FloatArray:
    norms: FloatArray = np.linalg.norm(twist.reshape(2, 3), axis=1)
    return norms
