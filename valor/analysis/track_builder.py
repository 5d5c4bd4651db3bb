"""A walk's track made while it is walked: kept as numbers, for a long walk has more messages than memory."""

from __future__ import annotations

from collections.abc import Iterable

from valor.analysis.walk import Track
from valor.common.messages import MotionState, Proprioceptor
from valor.robot.description import RobotDescription

_PIECE = 2000  # states that are kept as messages
_LATE = 200  # of them may still wait for the measurement that they answer


class TrackBuilder:
    """Takes in what an observer hears, in the order of time."""

    def __init__(self, robot: RobotDescription) -> None:
        self._robot = robot
        self._states: list[MotionState] = []
        self._measured: list[Proprioceptor] = []
        self._pieces: list[Track] = []

    def add(self, states: Iterable[MotionState], measured: Iterable[Proprioceptor]) -> None:
        """Take in what has come."""
        self._states += states
        self._measured += measured
        if len(self._states) > _PIECE:
            self._keep(_LATE)

    def track(self) -> Track | None:
        """All that was heard; None: no state with the measurement that it answers."""
        self._keep(0)
        pieces = [piece for piece in self._pieces if piece.time.size]
        return Track.joined(pieces) if pieces else None

    def _keep(self, late: int) -> None:
        split = len(self._states) - late
        if split > 0:
            self._pieces.append(Track.heard(self._states[:split], self._measured, self._robot))
            last = self._states[split - 1].proprioceptor_sequence
            self._measured = [each for each in self._measured if each.sequence > last]
            del self._states[:split]
