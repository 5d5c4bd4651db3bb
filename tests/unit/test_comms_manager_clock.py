"""How robot time is kept to the wall's, with a wall that the test moves."""

import ctypes
import math
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.common.pacing import LATE, Pacer, WallClock

PERIOD = 0.002


class SteppedWallClock(WallClock):
    """A wall clock that moves when it is slept on, or when the test moves it."""

    def __init__(self) -> None:
        self.time = 100.0
        self.slept = 0.0

    def now(self) -> float:
        return self.time

    def sleep(self, duration: float) -> None:
        assert duration > 0
        self.slept += duration
        self.time += duration


def test_without_a_rate_nothing_waits() -> None:
    wall = SteppedWallClock()
    pacer = Pacer(0.0, wall)
    for _ in range(100):
        assert pacer.pass_time(PERIOD) == 0.0
    assert wall.slept == 0.0
    pacer.pass_time(PERIOD, at_least_real_time=True)
    assert wall.slept == pytest.approx(PERIOD)
    assert pacer.slip == 0.0


@pytest.mark.parametrize("bounds", [(LATE, math.inf), (0.2, 1.25)])
def test_a_stall_is_slip_and_never_replayed(bounds: tuple[float, float]) -> None:
    wall = SteppedWallClock()
    pacer = Pacer(1.0, wall, *bounds)
    pacer.pass_time(PERIOD)
    wall.time += 0.3
    pacer.pass_time(PERIOD)
    assert pacer.slip == pytest.approx(0.3 - PERIOD)
    before = wall.time
    for _ in range(50):
        assert pacer.pass_time(PERIOD) > 0.0  # every period after it takes its time
    assert wall.time - before == pytest.approx(50 * PERIOD)


def test_a_backlog_is_made_up_with_bounded_haste() -> None:
    wall = SteppedWallClock()
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
    assert periods[-1] == pytest.approx(PERIOD) and wall.time - 100.0 == pytest.approx(1002 * PERIOD)
    assert pacer.slip == 0.0


@given(
    st.lists(st.floats(0, 0.05), min_size=1, max_size=200),
    st.sampled_from([0.5, 1.0, 2.0]),
    st.sampled_from([(LATE, math.inf), (0.02, 1.25), (0.2, 1.25)]),
)
def test_robot_time_and_slip_account_for_the_walls_time(
    work: list[float], rate: float, bounds: tuple[float, float]
) -> None:
    """Robot time never runs ahead nor too quickly, and what it lacks is slip or no more than what is made up."""
    wall = SteppedWallClock()
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
    wall = WallClock()
    for _ in range(200):
        before = wall.now()
        wall.sleep(0.001)
        assert wall.now() - before >= 0.001 - 1e-5
    assert ctypes.CDLL(None).prctl(30, 0, 0, 0, 0) == 1000, "the timer's slack (PR_GET_TIMERSLACK) [ns]"
    before = time.perf_counter()
    assert before <= wall.now() <= time.perf_counter()


def test_after_a_pause_nothing_is_made_up_and_another_rate_holds_at_once() -> None:
    wall = SteppedWallClock()
    pacer = Pacer(1.0, wall, backlog=0.2, haste=1.25)
    for _ in range(100):
        pacer.pass_time(PERIOD)
    wall.time += 30.0
    pacer.restart(0.1)
    began = wall.time
    for _ in range(100):
        pacer.pass_time(PERIOD)
    assert wall.time - began == pytest.approx(100 * PERIOD / 0.1)
    assert pacer.slip == 0.0
