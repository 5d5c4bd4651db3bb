"""What one end knows of the other's clock: bounds, not a guess.

Whatever arrives was sent before; what answers something was sent after it. Both bound the offset between the clocks
from either side, as in NTP (D. L. Mills, RFC 5905), and each bound is loosened as it grows old, for clocks drift.
"""

from __future__ import annotations

import math

DRIFT = 200e-6  # of two quartz clocks against each other at most, with a margin
LONG = 2**31


class OtherClock:
    """Bounds of the other end's clock [s] at a time of one's own [s]."""

    def __init__(self) -> None:
        self._least, self._least_at = -math.inf, 0.0
        self._most, self._most_at = math.inf, 0.0

    def arrived(self, clock: float, now: float) -> None:
        """What the other end sent at ``clock`` is here: its clock shows that, or more."""
        if clock - now >= self._offset_least(now):
            self._least, self._least_at = clock - now, now

    def answered(self, clock: float, asked: float, now: float) -> None:
        """At its ``clock`` it had what was sent from here at ``asked``: then its clock showed that, or less."""
        if clock - asked <= self._offset_most(now):
            self._most, self._most_at = clock - asked, now

    def _offset_least(self, now: float) -> float:
        return self._least - DRIFT * (now - self._least_at)

    def _offset_most(self, now: float) -> float:
        return self._most + DRIFT * (now - self._most_at)

    def least(self, now: float) -> float:
        """What it shows now, at least; −inf: nothing is known."""
        return now + self._offset_least(now)

    def most(self, now: float) -> float:
        """What it shows now, at most; inf: nothing is known."""
        return now + self._offset_most(now)

    def age(self, clock: float, now: float) -> float:
        """How old is what was so at its ``clock``, at most [s]; inf: nothing is known."""
        return self.most(now) - clock
