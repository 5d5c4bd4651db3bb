"""The recorder's clock: one offset for a whole bag, and a word when the clocks part."""

from __future__ import annotations

import time

import pytest

from bag_recorder import clock
from bag_recorder.clock import WallClock, measure_offset


def test_the_offset_is_what_lies_between_the_clocks() -> None:
    before = time.time_ns() - time.monotonic_ns()
    offset = measure_offset()
    after = time.time_ns() - time.monotonic_ns()
    assert min(before, after) - 50_000_000 <= offset <= max(before, after) + 50_000_000


def test_a_stamp_lands_between_two_looks_at_the_wall_clock() -> None:
    wall = WallClock()
    earliest = time.time_ns()
    stamp = time.monotonic_ns() + wall.offset
    latest = time.time_ns()
    assert earliest - 10_000_000 <= stamp <= latest + 10_000_000


def test_drift_is_told_once_for_every_notable_change(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = WallClock()
    start = wall.offset
    told = []
    for moved in (0, 400_000, 999_999, 1_000_000, 1_500_000, 2_100_000, 2_100_000, 0):
        monkeypatch.setattr(clock, "measure_offset", lambda moved=moved: start + moved)
        told.append(wall.check())
        assert (wall.offset, wall.drift) == (start, moved)
    assert told == [False, False, False, True, False, True, False, True]
