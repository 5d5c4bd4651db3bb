"""The filter of round trips, with clocks that differ, drift and reply late."""

import random

from hypothesis import given
from hypothesis import strategies as st

from bifrost.clocks import DRIFT, ClockFilter
from harness.waiting import some

SECOND = 1_000_000_000


@given(
    offset=st.integers(-100 * SECOND, 100 * SECOND),
    drift=st.floats(-50e-6, 50e-6),
    delays=st.lists(
        st.tuples(st.integers(10_000, 300_000_000), st.integers(10_000, 300_000_000)), min_size=1, max_size=60
    ),
)
def test_the_offset_is_within_its_error(offset: int, drift: float, delays: list[tuple[int, int]]) -> None:
    """However unequal the ways there and back, and whatever has queued on them."""
    clock = ClockFilter()
    for second, (there, back) in enumerate(delays):
        sent = second * SECOND
        at = sent + there
        clock.add(sent, at + offset + round(drift * at), at + back)
        now = at + back
        best = some(clock.best(now))
        true = offset + round(drift * now)
        assert abs(best.ahead - true) <= best.error + 2 + DRIFT * (there + back)


def test_of_three_seconds_and_fifty_ppm_no_millisecond_is_left() -> None:
    rng = random.Random(5)
    clock = ClockFilter()
    for second in range(600):
        there, back = (round(rng.expovariate(1 / 300_000)) + 50_000 for _ in range(2))
        at = second * SECOND + there
        clock.add(second * SECOND, at + 3 * SECOND + round(50e-6 * at), at + back)
        now = second * SECOND + SECOND - 1
        best = some(clock.best(now))
        if second > 5:
            assert abs(best.ahead - 3 * SECOND - 50e-6 * now) < 0.5e-3 * SECOND


def test_a_computer_that_was_started_anew_has_another_clock() -> None:
    clock = ClockFilter()
    for second in range(100):
        clock.add(second * SECOND, second * SECOND + 5000 * SECOND, second * SECOND + 100_000)
    clock.add(100 * SECOND, 20 * SECOND, 100 * SECOND + 80_000_000)
    best = clock.best(101 * SECOND)
    assert best is not None and abs(best.ahead + 80 * SECOND) < SECOND


def test_an_answer_before_its_question_is_passed_over() -> None:
    clock = ClockFilter()
    clock.add(10, 5, 9)
    assert clock.best(11) is None
