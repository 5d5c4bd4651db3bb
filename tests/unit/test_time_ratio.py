"""Ratio of robot time to wall time, from synthetic stamps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.time_ratio import TimeRatio

PERIOD = 0.002


def pace(periods: list[float]) -> TimeRatio:
    wall = 1000.0 + np.concatenate(([0.0], np.cumsum(periods)))
    return TimeRatio(wall, PERIOD * np.arange(len(wall), dtype=float))


def test_a_pause_determines_the_worst_second() -> None:
    seen = pace([PERIOD] * 1000 + [0.25] + [PERIOD] * 1000)
    assert seen.nominal == pytest.approx(PERIOD)
    assert seen.worst_second == pytest.approx((1.0 - 0.248) / 1.0, abs=0.003)
    assert seen.factor == pytest.approx(4.002 / 4.25) and seen.lost_beyond(2 * PERIOD) == pytest.approx(0.25 - PERIOD)


@given(st.lists(st.floats(0.001, 0.05), min_size=2, max_size=300))
def test_the_worst_second_and_losses(periods: list[float]) -> None:
    seen = pace(periods)
    lost = float(np.sum(seen.periods) - PERIOD * len(periods))
    behind = seen.lost_beyond(PERIOD)
    assert behind >= lost - 1e-9  # what was made up again is no less lost at first
    assert seen.worst_second <= seen.factor + 0.05 / PERIOD
    whole = [
        (seen.robot[j] - seen.robot[i]) / (seen.wall[j] - seen.wall[i])
        for i in range(len(seen.wall))
        for j in [int(np.searchsorted(seen.wall, seen.wall[i] + 1.0))]
        if j < len(seen.wall)
    ]
    assert seen.worst_second == pytest.approx(min(whole, default=seen.factor))
