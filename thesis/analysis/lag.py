"""Lag of a signal behind its cause, by cross-correlation (thesis 4.3.2).

The thesis correlates the two signals at one sample rate and takes the shift of the largest correlation (equations 4.3
to 4.7). Here the correlation at each shift is Pearson's, of the samples that the shifted signals share: it does not
grow with a signal's offset, nor shrink towards large shifts. A parabola through the peak gives the shift between
samples. Dissimilar signals also have a largest correlation; they are rejected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal as scipy_signal

from thesis.analysis.signals import Signal, common_rate
from thesis.errors import DissimilarSignalsError, SignalError
from valor.common.arrays import FloatArray

SIMILAR = 0.9  # minimum correlation of a signal and its cause
DISTINCT = 0.02  # minimum height of the peak above every other one, for periodic signals
FALL = 0.002  # minimum decrease of the correlation towards the longest delays; that of a straight line is constant
LEAST_SHARE = 0.5  # minimum overlap of two shifted signals, as a fraction of the samples
_FLAT = 1e-12  # relative variation below which a signal is constant


@dataclass(frozen=True)
class Lag:
    """The delay of a signal behind another.

    Attributes:
        seconds: positive: the second signal comes later (the sign of equation 4.3).
        rate: at which the signals were compared [Hz].
        correlation: at the peak, −1 to 1.
    """

    seconds: float
    rate: float
    correlation: float


def lag(first: Signal, second: Signal, longest: float = 1.0, similar: float = SIMILAR) -> Lag:
    """Lag of the second signal behind the first.

    Args:
        first: the cause.
        second: the effect.
        longest: maximum delay, in both directions [s].
        similar: minimum correlation.

    Raises:
        DissimilarSignalsError: a signal is constant, the signals are dissimilar, the delay exceeds ``longest``, or is
            ambiguous because the signals are periodic. States which.
        SignalError: the signals overlap too little.
    """
    rate, x, y = common_rate(first, second)
    reach = min(int(np.ceil(longest * rate)), int(len(x) * (1.0 - LEAST_SHARE)))
    if reach < 1:
        raise SignalError(f"{len(x)} samples in common: too few to look for a delay of {longest:g} s")
    shifts = np.arange(-reach, reach + 1)
    correlation = _correlation(x, y, reach)
    peak = int(np.argmax(correlation))
    highest = float(correlation[peak])
    if highest < similar:
        raise DissimilarSignalsError(
            f"the signals correlate by {highest:.2f} at best: expected {similar:g}; the one did not come from the other"
        )
    if peak in (0, len(shifts) - 1):
        raise DissimilarSignalsError(
            f"the signals correlate best at the longest delay looked for, {shifts[peak] / rate:+.3f} s"
        )
    if max(correlation[0], correlation[-1]) > highest - FALL:
        raise DissimilarSignalsError("the signals change too evenly: they correlate by the same at every delay")
    others = scipy_signal.argrelmax(correlation)[0]
    rivals = (float(correlation[i]) for i in others if i != peak and _valley(correlation, peak, int(i)))
    rival = max(rivals, default=-1.0)
    if rival > highest - DISTINCT:
        raise DissimilarSignalsError(
            f"the signals repeat themselves: another delay correlates by {rival:.3f}, the best by {highest:.3f}"
        )
    return Lag((shifts[peak] + _vertex(correlation[peak - 1 : peak + 2])) / rate, rate, highest)


def _correlation(x: FloatArray, y: FloatArray, reach: int) -> FloatArray:
    """(2·reach + 1,) Pearson's correlation of x(t) with y(t + k) for k from −reach to reach."""
    n = len(x)
    x, y = x - x.mean(), y - y.mean()
    if min(np.ptp(x), np.ptp(y)) <= _FLAT * max(np.abs(x).max(), np.abs(y).max(), _FLAT):
        raise DissimilarSignalsError("a signal does not change: no delay can be computed")
    shifts = np.arange(-reach, reach + 1)
    products = scipy_signal.correlate(y, x, mode="full")[n - 1 - reach : n + reach]
    # Of x the samples [a, b), of y those k later.
    a, b = np.maximum(0, -shifts), np.minimum(n, n - shifts)
    count = b - a
    sums = [np.concatenate(((0.0,), np.cumsum(each))) for each in (x, x * x, y, y * y)]
    sx, sxx = (total[b] - total[a] for total in sums[:2])
    sy, syy = (total[b + shifts] - total[a + shifts] for total in sums[2:])
    variance = np.maximum(sxx - sx * sx / count, 0.0) * np.maximum(syy - sy * sy / count, 0.0)
    tiny = _FLAT * float(x @ x) * float(y @ y)
    made: FloatArray = np.where(
        variance > tiny, (products - sx * sy / count) / np.sqrt(np.maximum(variance, tiny)), 0.0
    )
    return made


def _valley(correlation: FloatArray, peak: int, other: int) -> bool:
    """Return whether the correlation falls between two peaks: noise on one peak does not make it two."""
    low = float(correlation[min(peak, other) : max(peak, other) + 1].min())
    return low < float(correlation[other]) - DISTINCT


def _vertex(three: FloatArray) -> float:
    """Where the parabola through three equidistant values has its vertex, from the middle one, −0.5 to 0.5."""
    before, at, after = three
    curvature = before - 2.0 * at + after
    return float(0.5 * (before - after) / curvature) if curvature < 0.0 else 0.0
