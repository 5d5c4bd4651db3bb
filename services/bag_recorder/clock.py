"""From monotonic stamps to the wall clock: the offset taken at start, and how far the clocks have moved since.

The thesis (4.3.1) adds one offset, taken when the recorder starts, to every Bifrost stamp. The wall clock may be set or
slewed while a bag is recorded; the offset stays, so that intervals between Bifrost messages stay exact, and the drift
goes into the bag as metadata.
"""

from __future__ import annotations

import time

_TRIES = 20


def measure_offset() -> int:
    """Wall minus monotonic clock [ns]: of several readings the one between the closest monotonic stamps."""
    best_gap, best_offset = None, 0
    for _ in range(_TRIES):
        before = time.monotonic_ns()
        wall = time.time_ns()
        after = time.monotonic_ns()
        if best_gap is None or after - before < best_gap:
            best_gap, best_offset = after - before, wall - (before + after) // 2
    return best_offset


class WallClock:
    """Turns monotonic stamps [ns] into wall clock stamps [ns].

    Attributes:
        offset: wall minus monotonic at start [ns]; added to every stamp.
        drift: how much more it is now [ns], as last checked.
    """

    NOTABLE = 1_000_000  # [ns] of change between two reports

    def __init__(self) -> None:
        self.offset = measure_offset()
        self.drift = 0
        self._reported = 0

    def check(self) -> bool:
        """Measure the drift; True when it has changed notably since last told."""
        self.drift = measure_offset() - self.offset
        if abs(self.drift - self._reported) < self.NOTABLE:
            return False
        self._reported = self.drift
        return True
