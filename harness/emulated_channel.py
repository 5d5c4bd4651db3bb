"""Emulated channel: delay, jitter, loss, reordering, duplication, bandwidth, and blackouts by a schedule.

An ``EmulatedChannel`` computes the arrival times of a datagram from its seed, for tests in simulated time and for the
sockets of ``link_emulator.py``. The lengths of the blackouts are those of DARPA's "Degraded Comms Schedule Example" of
2 February 2015 for the finals, which MIT's team keeps in openhumanoids/oh-distro, ``software/network/maxwell-pro``.
They become shorter; after 45 minutes there are none.
"""

from __future__ import annotations

import math
import random
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from valor.link.classes import HEADERS

Windows = Sequence[tuple[float, float]]  # from, to [s], in order
WINDOW = 1.0  # between two blackouts [s]

# fmt: off
BLACKOUTS: tuple[int, ...] = (
    5, 1, 1, 30, 7, 30, 11, 6, 1, 7, 23, 2, 5, 20, 4, 16, 17, 1, 5, 10, 1, 7, 3, 4, 6, 16, 18, 16, 6, 10, 1, 22, 15,
    15, 8, 26, 6, 13, 9, 6, 7, 17, 6, 3, 24, 14, 5, 10, 3, 30, 1, 17, 12, 18, 10, 4, 24, 2, 3, 13, 6, 2, 4, 5, 7, 4,
    4, 5, 7, 3, 30, 12, 20, 6, 1, 6, 9, 4, 3, 4, 30, 1, 25, 2, 5, 1, 30, 7, 30, 9, 13, 1, 6, 18, 8, 1, 1, 6, 6, 6,
    3, 2, 3, 5, 3, 2, 5, 3, 1, 12, 1, 1, 1, 3, 4, 10, 1, 6, 10, 7, 7, 1, 10, 5, 13, 8, 4, 6, 10, 6, 13, 5, 17, 6, 4,
    3, 12, 2, 1, 13, 4, 4, 3, 5, 12, 8, 10, 8, 5, 1, 4, 2, 3, 6, 17, 5, 2, 6, 1, 16, 17, 9, 19, 6, 8, 7, 8, 3, 3, 1,
    13, 1, 7, 8, 1, 11, 4, 2, 19, 13, 12, 1, 7, 5, 1, 4, 7, 3, 2, 11, 10, 4, 1, 6, 3, 10, 19, 5, 2, 1, 1, 6, 1, 16,
    1, 9, 2, 21, 8, 4, 17, 5, 10, 3, 5, 14, 4, 3, 4, 7, 2, 1, 13, 14, 2, 4, 5, 6, 7, 1, 2, 2, 10, 1, 2, 1, 2, 6, 2,
    6, 4, 11, 6, 10, 9, 1, 12, 6, 15, 11, 23, 2, 3, 10, 1, 6, 3, 18, 8, 3, 8, 4, 4, 9, 7, 6, 8, 8, 4, 3, 6, 1, 1, 3,
    4, 4, 1, 1, 6, 3, 4, 2, 5, 1, 4, 2, 3, 1, 2, 15, 1, 6, 1, 2, 1, 8, 1, 1, 3, 1, 5, 3, 1, 2, 2, 1, 10, 4, 6, 8,
    12, 1, 1, 3, 4, 3, 2, 6, 7, 1, 1, 3, 2, 1, 3, 2, 2, 4, 2, 2, 7, 6, 2, 1, 1, 2, 6, 4, 1, 4, 2, 3, 1, 1, 2, 6, 2,
    3, 1, 8, 2, 6, 1, 2, 2, 3, 1, 1, 1, 4, 2, 3, 2, 1, 2, 3, 1, 1, 2, 7,
)
# fmt: on
"""[s]"""


def drc_windows() -> list[tuple[float, float]]:
    """DARPA's example: it begins with a window, and ends with one that lasts."""
    windows = list(_windows(0.0, BLACKOUTS))
    return [*windows, (windows[-1][1] + BLACKOUTS[-1], math.inf)]


def random_windows(seed: int, duration: float) -> list[tuple[float, float]]:
    """By chance, until ``duration`` [s]: blackouts of 1 to 30 s, one of them first."""
    chance = random.Random(seed)
    lengths = [chance.uniform(1.0, 30.0)]
    while sum(lengths) + WINDOW * len(lengths) < duration:
        lengths.append(chance.uniform(1.0, 30.0))
    return list(_windows(lengths[0], [*lengths[1:], 0.0]))


def _windows(begins: float, blackouts: Iterable[float]) -> Iterator[tuple[float, float]]:
    """A window before each blackout."""
    for length in blackouts:
        yield begins, begins + WINDOW
        begins += WINDOW + length


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


class EmulatedChannel:
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
        """Return whether it is no blackout."""
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
