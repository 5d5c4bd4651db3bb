"""How robot time is kept to the wall's, with a wall that the test moves."""

from __future__ import annotations

import ctypes
import math
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.common.pacing import LATE, Pacer, Wall

PERIOD = 0.002


class SteppedWall(Wall):
    """A wall clock that moves when it is slept on, or when the test says so."""

    def __init__(self) -> None:
        self.time = 100.0
        self.slept = 0.0

    def now(self) -> float:
        return self.time

    def sleep(self, duration: float) -> None:
        assert duration > 0
        self.slept += duration
        self.time += duration


def test_keeps_an_absolute_schedule() -> None:
    wall = SteppedWall()
    pacer = Pacer(1.0, wall)
    for work in (0.0005, 0.0019, 0.0001, 0.0012) * 100:
        wall.time += work
        pacer.pass_time(PERIOD)
    # The schedule begins with the first call, so that the work before it does not count.
    assert wall.time - 100.0 == pytest.approx(400 * PERIOD + 0.0005)
    assert pacer.slip == 0.0


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_robot_time_passes_at_the_rate(rate: float) -> None:
    wall = SteppedWall()
    pacer = Pacer(rate, wall)
    for _ in range(100):
        pacer.pass_time(PERIOD)
    assert wall.time - 100.0 == pytest.approx(100 * PERIOD / rate)


def test_without_a_rate_nothing_waits() -> None:
    wall = SteppedWall()
    pacer = Pacer(0.0, wall)
    for _ in range(100):
        assert pacer.pass_time(PERIOD) == 0.0
    assert wall.slept == 0.0
    pacer.pass_time(PERIOD, at_least_real_time=True)
    assert wall.slept == pytest.approx(PERIOD)
    assert pacer.slip == 0.0


def test_a_small_delay_is_made_up() -> None:
    wall = SteppedWall()
    pacer = Pacer(1.0, wall)
    pacer.pass_time(PERIOD)
    wall.time += PERIOD + 0.9 * LATE
    assert pacer.pass_time(PERIOD) == 0.0
    pacer.pass_time(PERIOD)
    assert wall.time - 100.0 == pytest.approx(3 * PERIOD)
    assert pacer.slip == 0.0


def test_a_stall_is_slip_and_never_replayed() -> None:
    wall = SteppedWall()
    pacer = Pacer(1.0, wall)
    pacer.pass_time(PERIOD)
    wall.time += 0.3
    pacer.pass_time(PERIOD)
    assert pacer.slip == pytest.approx(0.3 - PERIOD)
    before = wall.time
    for _ in range(50):
        assert pacer.pass_time(PERIOD) > 0.0  # every period after it takes its time
    assert wall.time - before == pytest.approx(50 * PERIOD)


def test_a_backlog_is_made_up_with_bounded_haste() -> None:
    wall = SteppedWall()
    pacer = Pacer(1.0, wall, backlog=0.2, haste=1.25)
    pacer.pass_time(PERIOD)
    wall.time += 0.1
    pacer.pass_time(PERIOD)
    ends = []
    for _ in range(1000):
        pacer.pass_time(PERIOD)
        assert wall.time == pytest.approx(pacer.end)
        ends.append(wall.time)
    periods = np.diff(ends)
    assert periods.min() == pytest.approx(PERIOD / 1.25)
    # 98 ms, 0.4 ms a period
    assert np.count_nonzero(periods < 0.99 * PERIOD) == pytest.approx(0.098 / 0.0004, abs=2)
    assert periods[-1] == pytest.approx(PERIOD)
    assert wall.time - 100.0 == pytest.approx(1002 * PERIOD)
    assert pacer.slip == 0.0


def test_more_than_the_backlog_is_slip() -> None:
    wall = SteppedWall()
    pacer = Pacer(1.0, wall, backlog=0.2, haste=1.25)
    pacer.pass_time(PERIOD)
    wall.time += 0.3
    pacer.pass_time(PERIOD)
    assert pacer.slip == pytest.approx(0.3 - PERIOD)
    assert pacer.pass_time(PERIOD) == pytest.approx(PERIOD)


@given(
    st.lists(st.floats(0, 0.05), min_size=1, max_size=200),
    st.sampled_from([0.5, 1.0, 2.0]),
    st.sampled_from([(LATE, math.inf), (0.02, 1.25), (0.2, 1.25)]),
)
def test_robot_time_and_slip_account_for_the_walls_time(
    work: list[float], rate: float, bounds: tuple[float, float]
) -> None:
    """Robot time never runs ahead nor too quickly, and what it lacks is slip or no more than what is made up."""
    wall = SteppedWall()
    backlog, haste = bounds
    pacer = Pacer(rate, wall, backlog, haste)
    pacer.pass_time(PERIOD)
    begun = wall.time - PERIOD / rate
    for index, duration in enumerate(work, start=2):
        before = wall.time
        wall.time += duration
        pacer.pass_time(PERIOD)
        assert wall.time - before >= PERIOD / rate / haste - 1e-9
        behind = (wall.time - begun) * rate - index * PERIOD
        assert -1e-9 <= behind - pacer.slip <= backlog * rate + 1e-9


def test_the_wall_sleeps_no_shorter_than_asked_and_has_itself_woken_at_once() -> None:
    wall = Wall()
    for _ in range(200):
        before = wall.now()
        wall.sleep(0.001)
        assert wall.now() - before >= 0.001 - 1e-5
    assert ctypes.CDLL(None).prctl(30, 0, 0, 0, 0) == 1000, "the timer's slack (PR_GET_TIMERSLACK) [ns]"
    before = time.perf_counter()
    assert before <= wall.now() <= time.perf_counter()


def test_after_a_pause_nothing_is_made_up_and_another_rate_holds_at_once() -> None:
    wall = SteppedWall()
    pacer = Pacer(1.0, wall, backlog=0.2, haste=1.25)
    for _ in range(100):
        pacer.pass_time(PERIOD)
    wall.time += 30.0
    pacer.begin_anew(0.1)
    began = wall.time
    for _ in range(100):
        pacer.pass_time(PERIOD)
    assert wall.time - began == pytest.approx(100 * PERIOD / 0.1)
    assert pacer.slip == 0.0
