"""Bounds of the other end's clock."""

import math

DRIFT = 200e-6  # upper bound for two quartz clocks, with a margin


class OtherClock:
    """Bounds of the other end's clock [s] at a time of the local clock [s].

    A message that arrives was sent before, one that answers another after it: both bound the offset of the clocks, as
    in NTP (D. L. Mills, RFC 5905). Each bound is relaxed with its age, as clocks drift.
    """

    def __init__(self) -> None:
        self._lowest_offset, self._lowest_at = -math.inf, 0.0
        self._highest_offset, self._highest_at = math.inf, 0.0

    def received(self, clock: float, now: float) -> None:
        """Process a message that the other end sent at its ``clock``."""
        if clock >= self.lower_bound(now):
            self._lowest_offset, self._lowest_at = clock - now, now

    def echoed(self, clock: float, sent: float, now: float) -> None:
        """Process an answer sent at the other end's ``clock`` to a message sent at the local time ``sent``."""
        if clock - sent <= self.upper_bound(now) - now:
            self._highest_offset, self._highest_at = clock - sent, now

    def lower_bound(self, now: float) -> float:
        """Lower bound of the other clock now; −inf before the first message."""
        return now + self._lowest_offset - DRIFT * (now - self._lowest_at)

    def upper_bound(self, now: float) -> float:
        """Upper bound of the other clock now; inf before the first echo."""
        return now + self._highest_offset + DRIFT * (now - self._highest_at)

    def age(self, clock: float, now: float) -> float:
        """Upper bound of the age of a value measured at the other end's ``clock`` [s]; inf before the first echo."""
        return self.upper_bound(now) - clock
