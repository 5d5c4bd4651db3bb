"""Delays between signals are found where they are known, and refused where there are none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from valor.analysis.errors import DissimilarSignalsError, SignalError
from valor.analysis.lag import lag, lags
from valor.analysis.signals import Signal, common_rate
from valor.common.arrays import FloatArray


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
    assert found.whole == pytest.approx(delay, abs=0.51 * found.resolution + 0.1 * step)
    assert found.rate == pytest.approx(max(rate, other), rel=1e-3)
    assert found.correlation > 0.999


@pytest.mark.parametrize("seed", range(5))
def test_noise_makes_it_uncertain_by_a_fraction_of_a_sample(seed: int) -> None:
    found = lag(sampled(0.0, 500.0, noise=0.05, seed=seed), sampled(0.0437, 250.0, noise=0.05, seed=seed + 100))
    assert found.seconds == pytest.approx(0.0437, abs=0.002)


def test_offset_and_scale_do_not_matter() -> None:
    before, after = sampled(0.0, 500.0), sampled(0.1, 500.0)
    assert lag(before, Signal(after.time, 100.0 + 0.01 * after.value)).seconds == pytest.approx(0.1, abs=1e-4)


def test_exchanged_signals_have_the_opposite_delay() -> None:
    before, after = sampled(0.0, 500.0), sampled(0.0625, 400.0)
    assert lag(before, after).seconds == pytest.approx(-lag(after, before).seconds, abs=2e-4)


def test_stamps_out_of_order_and_twice_are_put_right() -> None:
    whole = sampled(0.0, 500.0)
    order = np.random.default_rng(1).permutation(np.repeat(np.arange(len(whole)), 2))
    mixed = Signal.of(whole.time[order], whole.value[order])
    np.testing.assert_array_equal(mixed.time, whole.time)
    np.testing.assert_allclose(mixed.value, whole.value, atol=1e-15)
    assert lag(mixed, sampled(0.05, 250.0)).seconds == pytest.approx(0.05, abs=4e-4)


def test_windows_tell_mean_and_deviation_and_pass_over_rest() -> None:
    t = np.arange(0.0, 20.0, 0.002)
    move = np.where(t < 10.0, motion(t), motion(np.array([10.0]))[0])
    then = np.where(t - 0.03 < 10.0, motion(t - 0.03), motion(np.array([10.0]))[0])
    found = lags(Signal.of(t, move), Signal.of(t, then), window=2.0, longest=0.3)
    assert 4 <= len(found) <= 6
    assert np.mean([each.seconds for each in found]) == pytest.approx(0.03, abs=5e-4)
    assert np.std([each.seconds for each in found]) < 1e-3


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (lambda t: np.random.default_rng(2).standard_normal(len(t)), "did not come from the other"),
        (lambda t: -motion(t), "did not come from the other"),
        (np.zeros_like, "does not change"),
        (lambda t: motion(t - 0.9), "longest delay looked for|did not come"),
    ],
)
def test_dissimilar_signals_are_refused(other: object, said: str) -> None:
    t = np.arange(0.0, 8.0, 0.002)
    assert callable(other)
    with pytest.raises(DissimilarSignalsError, match=said):
        lag(Signal.of(t, motion(t)), Signal.of(t, other(t)), longest=0.5)


def test_a_wave_that_repeats_itself_is_refused() -> None:
    t = np.arange(0.0, 8.0, 0.002)
    with pytest.raises(DissimilarSignalsError, match="repeat themselves"):
        lag(Signal.of(t, np.sin(2 * math.pi * 3 * t)), Signal.of(t, np.sin(2 * math.pi * 3 * (t - 0.1))))


def test_a_straight_line_is_refused() -> None:
    t = np.arange(0.0, 8.0, 0.002)
    with pytest.raises(DissimilarSignalsError, match="same at every delay"):
        lag(Signal.of(t, t), Signal.of(t, t - 0.1))


def test_signals_without_common_time_are_refused() -> None:
    with pytest.raises(SignalError, match="samples in common"):
        common_rate(sampled(0.0, 500.0, 0.0, 2.0), sampled(0.0, 500.0, 3.0, 5.0))
    with pytest.raises(SignalError, match="at 2 moments"):
        Signal.of([0.0, 1.0, 1.0], [1.0, 2.0, 3.0])
    with pytest.raises(SignalError, match="two vectors"):
        Signal.of([0.0, 1.0], [1.0, 2.0, 3.0])


def test_the_mean_rate_is_that_of_the_intervals() -> None:
    assert sampled(0.0, 250.0).rate == pytest.approx(250.0)
    assert sampled(0.0, 250.0).derivative().rate == pytest.approx(250.0)
