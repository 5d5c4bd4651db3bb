"""When the robot begins to fall."""

from __future__ import annotations

from valor.common.behaviors import Behavior
from valor.common.messages import MotionState

FALL = Behavior.FALL  # also the label of a bag


class Falls:
    """Follows the Motion Manager's words."""

    def __init__(self) -> None:
        self._fallen = False

    def begins(self, state: MotionState) -> bool:
        """Whether a fall begins with this word."""
        before, self._fallen = self._fallen, state.behavior == FALL
        return self._fallen and not before
