"""What recurs on robot time."""

from __future__ import annotations


class Schedule:
    """When something is due again: so long after it was due last, not after it was done, which was a little later."""

    def __init__(self) -> None:
        self._next = 0

    def begin(self, time: int) -> None:
        """It is due at this robot time [ns]."""
        self._next = time

    def due(self, time: int, period: int) -> bool:
        """Whether it is due at a robot time; then it is next due a period later [ns].

        Where time has gone back, or on by more than a period, the schedule begins anew.
        """
        if self._next - period <= time < self._next:
            return False
        self._next = (self._next if self._next <= time < self._next + period else time) + period
        return True
