"""The recorder's clock: one offset for a whole bag, and a word when the clocks part."""

from __future__ import annotations

import time

import pytest

from valor.bag_recorder import clock
from valor.bag_recorder.clock import WallClock, measure_offset


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
        assert (wall.offset, wall.drift, wall.steps) == (start, moved, 0)
    assert [change is not None for change in told] == [False, False, False, True, False, True, False, True]
    changes = [change for change in told if change is not None]
    assert [(change.kind, change.moved, change.drift) for change in changes] == [
        ("drift", 1_000_000, 1_000_000), ("drift", 1_100_000, 2_100_000), ("drift", -2_100_000, 0),
    ]  # fmt: skip


def test_a_clock_that_is_set_has_stepped_and_one_that_is_slewed_has_not(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = WallClock()
    start = wall.offset
    assert not wall.moved()
    told = []
    for moved in (10_000_000, 3_600_000_000_000, 3_600_001_500_000, 0):
        monkeypatch.setattr(clock, "measure_offset", lambda moved=moved: start + moved)
        told.append(wall.check())
    assert [change.kind for change in told if change is not None] == ["drift", "step", "drift", "step"]
    assert wall.steps == 2 and wall.metadata()["steps"] == "2"
    wall.drift = 3_600_000_000_000  # as if the clock had been set back by an hour since
    assert wall.moved()
