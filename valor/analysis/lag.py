"""How much later a signal is than another that it came from, by cross-correlation (thesis 4.3.2).

The thesis correlates the two signals at one sample rate and takes the shift of the largest correlation (equations 4.3
to 4.7). Here the correlation at each shift is Pearson's, of the samples that the shifted signals share: it does not
grow with a signal's offset, nor shrink towards large shifts. A parabola through the peak tells the shift between
samples. Signals that do not resemble one another have a largest correlation too; they are refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal as scipy_signal

from valor.analysis.errors import DissimilarSignalsError, SignalError
from valor.analysis.signals import Signal, common_rate
from valor.common.arrays import FloatArray

SIMILAR = 0.9  # the least correlation of two signals of which one came from the other
DISTINCT = 0.02  # by how much the peak must stand above every other one, where the signals repeat themselves
FALL = 0.002  # by how much the correlation must fall towards the longest delays: that of a straight line does not
LEAST_SHARE = 0.5  # of the samples that two shifted signals must still share
_FLAT = 1e-12  # a signal that varies less than this, of its size, says nothing


@dataclass(frozen=True)
class Lag:
    """The delay of a signal behind another.

    Attributes:
        seconds: positive: the second signal comes later (the sign of equation 4.3).
        samples: the whole number of samples that the thesis' method gives (equation 4.5).
        rate: at which the signals were compared [Hz]; 1/rate is the resolution of the thesis' method.
        correlation: at the peak, −1 to 1.
    """

    seconds: float
    samples: int
    rate: float
    correlation: float

    @property
    def resolution(self) -> float:
        """Between two shifts of the thesis' method [s]."""
        return 1.0 / self.rate

    @property
    def whole(self) -> float:
        """The delay as the thesis' method gives it (equation 4.6) [s]."""
        return self.samples / self.rate


def lag(first: Signal, second: Signal, longest: float = 1.0, similar: float = SIMILAR) -> Lag:
    """How much later the second signal is.

    Args:
        first: the signal.
        second: what came of it.
        longest: delay that is looked for, in both directions [s].
        similar: the least correlation that is believed.

    Raises:
        DissimilarSignalsError: a signal does not change, they do not resemble one another, the delay is beyond what was
            looked for, or the signals repeat themselves so that several delays would do. Says which.
        SignalError: they have too little time in common.
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
    return Lag((shifts[peak] + _vertex(correlation[peak - 1 : peak + 2])) / rate, int(shifts[peak]), rate, highest)


def lags(first: Signal, second: Signal, window: float, longest: float = 1.0, similar: float = SIMILAR) -> list[Lag]:
    """The delay in each window of some seconds in which it can be told, for its mean and deviation.

    Args:
        first: the signal.
        second: what came of it.
        window: length of the parts that are compared [s].
        longest: as for ``lag`` [s].
        similar: as for ``lag``.
    """
    begin, end = max(first.time[0], second.time[0]), min(first.time[-1], second.time[-1])
    found: list[Lag] = []
    for start in np.arange(begin, end - 0.5 * window, window):
        try:
            stop = min(start + window, end)
            found.append(lag(first.between(start, stop), second.between(start, stop), longest, similar))
        except SignalError:  # nothing moved, or nothing that resembles
            continue
    return found


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
    """Whether the correlation falls between two peaks: noise on one peak does not make it two."""
    low = float(correlation[min(peak, other) : max(peak, other) + 1].min())
    return low < float(correlation[other]) - DISTINCT


def _vertex(three: FloatArray) -> float:
    """Where the parabola through three equidistant values has its vertex, from the middle one, −0.5 to 0.5."""
    before, at, after = three
    curvature = before - 2.0 * at + after
    return float(0.5 * (before - after) / curvature) if curvature < 0.0 else 0.0
