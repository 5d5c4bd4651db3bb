"""Keeping to a line while walking by velocity: what the robot believes of its heading and place, back into its command.

The robot walks any way it is told, so the line's two errors are taken back by themselves::

    e = (p − p₀)·n                                  beside the line, n to its left [m]
    v = speed·t − clip(g·e, ±SIDEWAYS)·n            in odom; turned into the robot's heading ψ
    w = −clip(h·(ψ − ψ₀), ±TURNING)

The gains are slow against the steps, whose swaying they must not follow.
"""

from __future__ import annotations

import math

from valor.common import rotation
from valor.common.messages import MotionState

_OFFSET_GAIN = 0.3  # g [1/s]
_HEADING_GAIN = 0.6  # h [1/s]
SIDEWAYS = 0.06  # [m/s]
TURNING = 0.15  # [rad/s]


def heading(state: MotionState) -> float:
    """Of the pelvis in odom [rad]."""
    return rotation.heading(state.pelvis_orientation_in_odom.tolist())


class Line:
    """The line that a robot which stands at ``state`` is to walk along, keeping its heading."""

    def __init__(self, state: MotionState, forward: float, left: float) -> None:
        """``forward`` and ``left``: the velocity wanted [m/s]."""
        self._start = state.pelvis_position_in_odom[:2].copy()
        self._heading = heading(state)
        self._speed = math.hypot(forward, left)
        direction = self._heading + math.atan2(left, forward)
        self._along = (math.cos(direction), math.sin(direction))

    def place(self, state: MotionState) -> tuple[float, float]:
        """How far along the line, and how far to its left [m]."""
        x, y = (state.pelvis_position_in_odom[:2] - self._start).tolist()
        cos, sin = self._along
        return x * cos + y * sin, y * cos - x * sin

    def turned(self, state: MotionState) -> float:
        """How far from the heading at the start, anticlockwise [rad]."""
        return math.remainder(heading(state) - self._heading, 2.0 * math.pi)

    def steer(self, state: MotionState) -> tuple[float, float, float]:
        """The velocity to ask for: forward, left [m/s], turning [rad/s]."""
        _, offset = self.place(state)
        back = -_clip(_OFFSET_GAIN * offset, SIDEWAYS)
        cos, sin = self._along
        x, y = self._speed * cos - back * sin, self._speed * sin + back * cos
        psi = heading(state)
        forward, left = x * math.cos(psi) + y * math.sin(psi), y * math.cos(psi) - x * math.sin(psi)
        return forward, left, -_clip(_HEADING_GAIN * self.turned(state), TURNING)


def _clip(value: float, bound: float) -> float:
    return max(-bound, min(bound, value))
