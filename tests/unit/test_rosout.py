"""What is let through to /rosout, and what stands for the rest."""

from __future__ import annotations

import itertools

from valor.ros.rosout import Sieve


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_the_same_line_passes_seldom_a_kind_more_often_and_no_flood_at_all() -> None:
    clock = Clock()
    sieve = Sieve(clock)
    assert sum(sieve.passes("kind", "text") for _ in range(1000)) == Sieve.ALIKE
    assert sum(sieve.passes("kind", str(i)) for i in range(1000)) == Sieve.OF_A_KIND - Sieve.ALIKE
    assert sum(sieve.passes(str(i), "text") for i in range(1000)) == Sieve.IN_ALL - Sieve.OF_A_KIND
    assert sieve.left_out() == 3000 - Sieve.IN_ALL and sieve.left_out() == 0
    clock.now += Sieve.WINDOW
    assert sieve.passes("kind", "text")


def test_however_long_a_flood_lasts_it_is_bounded_in_lines_and_memory() -> None:
    clock, seconds = Clock(), 20
    sieve = Sieve(clock)
    passed = 0
    for i in itertools.count():
        clock.now = 100.0 + i / 500
        if clock.now >= 100.0 + seconds:
            break
        passed += sieve.passes(i, str(i))
        assert len(sieve._seen) <= 4 * Sieve.IN_ALL
    assert passed <= Sieve.IN_ALL * (seconds + 1)
    assert passed + sieve.left_out() == i
