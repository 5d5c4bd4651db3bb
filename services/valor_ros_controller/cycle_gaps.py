"""How far apart the VRC's cycles are in robot time: one that comes late leaves a gap in the set-points."""

from __future__ import annotations

WINDOW = 1.0  # of which the longest gap is told, twice that at most [s]
STRANGE = 100_000  # periods: more is no gap but another robot time


class CycleGaps:
    """Counts late cycles. Of one thread.

    Attributes:
        late: how many there were.
    """

    def __init__(self, expected: int) -> None:
        """``expected``: the longest gap that is none [periods]."""
        self._expected = expected
        self._now = self._before = 0  # longest of this window and of the one before [periods]
        self._ends = 0.0
        self.late = 0

    def note(self, periods: int, now: float) -> None:
        """A cycle came so long after the one before [periods], at a time [s]."""
        if not 0 < periods < STRANGE:
            return
        self._turn(now)
        self._now = max(self._now, periods)
        self.late += periods > self._expected

    def longest(self, now: float) -> int:
        """Gap of the last seconds [periods]."""
        self._turn(now)
        return max(self._now, self._before)

    def _turn(self, now: float) -> None:
        if now >= self._ends:
            self._before = self._now if now < self._ends + WINDOW else 0
            self._now, self._ends = 0, now + WINDOW
