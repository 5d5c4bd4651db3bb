"""When the DRC's second channel was there: DARPA's example of a schedule for the finals, and others at random.

The lengths of the blackouts are those of DARPA's "Degraded Comms Schedule Example" of 2 February 2015, which MIT's team
keeps in openhumanoids/oh-distro, ``software/network/maxwell-pro``. They grow shorter, and after 45 minutes there are
none.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterable, Iterator, Sequence

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
