"""Delays between signals are found where they are known, and refused where there are none."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from thesis.analysis.lag import lag
from thesis.analysis.signals import Signal, common_rate
from thesis.errors import DissimilarSignalsError, SignalError
from valor.common.arrays import FloatArray

Shape = Callable[[FloatArray], FloatArray]


def motion(t: FloatArray) -> FloatArray:
    """As a joint moves: rests and quick smooth turns, of frequencies up to some 3 Hz that never repeat."""
    return np.tanh(3.0 * np.sin(1.3 * t + 0.4 * t * t)) + 0.5 * np.sin(0.37 * t) + 0.3 * np.exp(-((t - 3.0) ** 2))


def sampled(
    delay: float, rate: float, begin: float = 0.0, end: float = 8.0, noise: float = 0.0, seed: int = 0
) -> Signal:
    t = np.arange(begin, end, 1.0 / rate)
    return Signal.of(t, motion(t - delay) + noise * np.random.default_rng(seed).standard_normal(len(t)))


@examples(60)
@given(
    delay=st.floats(-0.4, 0.4),
    rate=st.sampled_from([250.0, 333.0, 500.0]),
    other=st.sampled_from([100.0, 250.0, 500.0]),
)
def test_a_known_delay_is_found_between_samples(delay: float, rate: float, other: float) -> None:
    found = lag(sampled(0.0, rate, 0.0013), sampled(delay, other))
    step = 1.0 / min(rate, other)
    assert found.seconds == pytest.approx(delay, abs=0.1 * step)
    assert found.rate == pytest.approx(max(rate, other), rel=1e-3) and found.correlation > 0.999
    before, after = sampled(0.0, rate, 0.0013), sampled(delay, other)
    assert lag(after, before).seconds == pytest.approx(-found.seconds, abs=0.1 * step)
    scaled = Signal(after.time, 100.0 + 0.01 * after.value)
    assert lag(before, scaled).seconds == pytest.approx(found.seconds, abs=1e-6)


def test_stamps_out_of_order_and_twice_are_put_right() -> None:
    whole = sampled(0.0, 500.0)
    order = np.random.default_rng(1).permutation(np.repeat(np.arange(len(whole)), 2))
    mixed = Signal.of(whole.time[order], whole.value[order])
    np.testing.assert_array_equal(mixed.time, whole.time)
    np.testing.assert_allclose(mixed.value, whole.value, atol=1e-15)
    assert lag(mixed, sampled(0.05, 250.0)).seconds == pytest.approx(0.05, abs=4e-4)


@pytest.mark.parametrize(
    ("one", "other", "said"),
    [
        (motion, lambda t: np.random.default_rng(2).standard_normal(len(t)), "did not come from the other"),
        (motion, lambda t: -motion(t), "did not come from the other"),
        (motion, np.zeros_like, "does not change"),
        (motion, lambda t: motion(t - 0.9), "longest delay looked for|did not come"),
        (lambda t: np.sin(6 * math.pi * t), lambda t: np.sin(6 * math.pi * (t - 0.1)), "repeat themselves"),
        (lambda t: t, lambda t: t - 0.1, "same at every delay"),
    ],
)
def test_signals_without_a_unique_delay_are_rejected(one: Shape, other: Shape, said: str) -> None:
    t = np.arange(0.0, 8.0, 0.002)
    with pytest.raises(DissimilarSignalsError, match=said):
        lag(Signal.of(t, one(t)), Signal.of(t, other(t)), longest=0.5)


def test_signals_without_common_time_are_rejected() -> None:
    with pytest.raises(SignalError, match="samples in common"):
        common_rate(sampled(0.0, 500.0, 0.0, 2.0), sampled(0.0, 500.0, 3.0, 5.0))
    with pytest.raises(SignalError, match="at 2 moments"):
        Signal.of([0.0, 1.0, 1.0], [1.0, 2.0, 3.0])
    with pytest.raises(SignalError, match="two vectors"):
        Signal.of([0.0, 1.0], [1.0, 2.0, 3.0])
