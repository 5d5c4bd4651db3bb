"""How many chunks may be under way: as many as come back in time, so that neither channel nor computer is flooded."""

from __future__ import annotations

FIRST, LEAST, MOST = 64, 32, 2048  # chunks
TOLERATED = 0.2  # share of what was asked for that may be lost without that anybody slows down
QUICKEST, SLOWEST = 0.05, 1.0  # after which what has not come is asked for again [s]
HASTY, CALM = 1.05, 0.9975  # by which patience grows when it was too short, and shrinks else
JUDGED = 32  # chunks, at least, of which a share is told


class Pace:
    """Of what is asked for, on one channel.

    Attributes:
        credit: chunks that may be under way.
    """

    def __init__(self) -> None:
        self.credit = float(FIRST)
        self._round, self._spread = 0.0, 0.0  # trip [s]
        self._least = QUICKEST
        self._starting = True
        self._came = self._lost = 0

    @property
    def patience(self) -> float:
        """After which what has not come counts as lost [s]."""
        return min(max(self._least, self._round + 4.0 * self._spread), SLOWEST)

    def came(self, trip: float) -> None:
        """A chunk, so long after it was asked for [s]; 0: it counted as lost before."""
        self._came += 1
        if trip == 0.0:  # so it was not: a computer that is busy answers late
            self._least = min(HASTY * self.patience, SLOWEST)
            self._lost = max(self._lost - 1, 0)
        else:
            self._least = max(CALM * self._least, QUICKEST)
            off = trip - self._round
            self._spread += (abs(off) - self._spread) / 64.0
            self._round += off / 64.0
        self.credit = min(self.credit + (1.0 if self._starting else 8.0 / self.credit), MOST)

    def lost(self, count: int) -> None:
        """So many have not come in time."""
        self._lost += count
        all_ = self._came + self._lost
        if all_ < max(JUDGED, 0.5 * self.credit):
            return
        if self._lost > TOLERATED * all_:
            self.credit = max(0.5 * self.credit, LEAST)
            self._starting = False
        self._came = self._lost = 0

    def closed(self) -> None:
        """The channel is gone; when it is back, it begins with what it bore, halved."""
        self.credit = max(0.5 * self.credit, FIRST)
        self._starting = True
        self._came = self._lost = 0
