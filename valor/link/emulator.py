"""A bad link, in numbers: delay, jitter, loss, reordering, duplication, bandwidth, and blackouts by a schedule.

A ``Line`` says when, and how often, a datagram comes out that goes in at a time: a pure function of its seed, for tests
in simulated time as for the sockets of ``emulate.py``.
"""

from __future__ import annotations

import random
from bisect import bisect_right
from dataclasses import dataclass

from valor.link.classes import HEADERS
from valor.link.schedule import Windows


@dataclass(frozen=True)
class Conditions:
    """Of one direction of one channel.

    Attributes:
        bandwidth: of everything, headers included [bit/s]; 0: without end.
        delay: of every datagram [s].
        jitter: added to it, from 0 to this, evenly [s].
        loss: probability that a datagram never comes.
        duplication: probability that it comes twice.
        reordering: probability that it is held back by ``held`` [s], so that others overtake it.
        held: [s].
        waiting: bytes that may wait for the bandwidth; what comes on top is lost [B].
    """

    bandwidth: float = 0.0
    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    duplication: float = 0.0
    reordering: float = 0.0
    held: float = 0.5
    waiting: int = 4800


DRC_SLOW = Conditions(bandwidth=9600.0, delay=0.05)
DRC_FAST = Conditions(bandwidth=300e6, delay=0.002, waiting=4_000_000)
"""DARPA's in the finals of 2015: the first always on, the second in windows of 1 s (``schedule.py``).

DARPA's second one led from the robot alone; here it leads both ways.
"""


class Line:
    """One direction of one channel; both ways share the bandwidth of a ``Bandwidth``."""

    def __init__(
        self, conditions: Conditions, seed: int, windows: Windows | None = None, shared: Bandwidth | None = None
    ) -> None:
        """A line.

        Args:
            conditions: of it.
            seed: of all that is random.
            windows: when it is there; None: always.
            shared: by both directions; None: this one has its own.
        """
        self._conditions, self._chance = conditions, random.Random(seed)
        self._windows = windows
        self._starts = [start for start, _ in windows or ()]
        self._bandwidth = shared or Bandwidth(conditions)
        self.passed = self.lost = 0  # [B]

    def there(self, now: float) -> bool:
        """Whether it is no blackout."""
        if self._windows is None:
            return True
        place = bisect_right(self._starts, now) - 1
        return place >= 0 and now < self._windows[place][1]

    def put(self, size: int, now: float) -> list[float]:
        """When a datagram of ``size`` [B] that goes in now comes out; nothing: it is lost. In the order of time."""
        conditions, chance = self._conditions, self._chance.random
        size += HEADERS
        fates = (chance(), chance(), chance(), chance(), chance())  # as many each time: a seed is a history
        through = self._bandwidth.through(size, now) if self.there(now) else None
        if through is None or fates[0] < conditions.loss or not self.there(through):
            self.lost += size
            return []
        self.passed += size
        arrival = through + conditions.delay + fates[1] * conditions.jitter
        if fates[2] < conditions.reordering:
            arrival += conditions.held
        return [arrival, arrival + conditions.held * fates[4]] if fates[3] < conditions.duplication else [arrival]


class Bandwidth:
    """A queue before a line of so many bits a second."""

    def __init__(self, conditions: Conditions) -> None:
        self._rate, self._most = conditions.bandwidth / 8.0, conditions.waiting
        self._free_at = 0.0

    def through(self, size: int, now: float) -> float | None:
        """When a datagram is through; None: there is no place for it."""
        if not self._rate:
            return now
        begins = max(now, self._free_at)
        if (begins - now) * self._rate + size > self._most:
            return None
        self._free_at = begins + size / self._rate
        return self._free_at
