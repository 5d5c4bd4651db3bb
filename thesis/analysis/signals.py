"""Sampled signals: cleaning and resampling to a common rate (thesis 4.3.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from thesis.errors import SignalError
from valor.common.arrays import FloatArray

_FEWEST = 3  # minimum number of samples with a rate


@dataclass(frozen=True)
class Signal:
    """A real signal at ascending moments; make it with ``of``.

    Attributes:
        time: (n,) strictly ascending [s].
        value: (n,) finite.
    """

    time: FloatArray
    value: FloatArray

    @classmethod
    def of(cls, time: npt.ArrayLike, value: npt.ArrayLike) -> Self:
        """From recorded samples: sorted by stamp, averaged at equal stamps, without NaN.

        Raises:
            SignalError: not two vectors of one length, or fewer than three moments.
        """
        t, x = np.asarray(time, dtype=np.float64), np.asarray(value, dtype=np.float64)
        if t.ndim != 1 or t.shape != x.shape:
            raise SignalError(f"time of shape {t.shape} and value of {x.shape}: expected two vectors of one length")
        known = np.isfinite(t) & np.isfinite(x)
        moments, which, count = np.unique(t[known], return_inverse=True, return_counts=True)
        if len(moments) < _FEWEST:
            raise SignalError(f"samples at {len(moments)} moments: expected at least {_FEWEST}")
        return cls(moments, np.bincount(which, x[known]) / count)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def duration(self) -> float:
        """From the first sample to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def rate(self) -> float:
        """The mean sample rate [Hz]: the samples after the first over the duration (equation 4.7)."""
        return (len(self) - 1) / self.duration

    def between(self, first: float, last: float) -> Signal:
        """The part between two times [s].

        Raises:
            SignalError: it has fewer than three samples.
        """
        near = (self.time >= first) & (self.time <= last)
        return Signal.of(self.time[near], self.value[near])

    def resampled(self, moments: FloatArray) -> FloatArray:
        """(m,) values at other times, by linear interpolation."""
        return np.interp(moments, self.time, self.value)


def common_rate(first: Signal, second: Signal) -> tuple[float, FloatArray, FloatArray]:
    """Resample two signals over their common time, at the higher of their mean rates.

    Returns:
        The rate [Hz], and both signals' values, (n,) each.

    Raises:
        SignalError: their common time is too short.
    """
    begin, end = max(first.time[0], second.time[0]), min(first.time[-1], second.time[-1])
    rate = max(first.rate, second.rate)
    count = int(np.floor((end - begin) * rate)) + 1 if end > begin else 0
    if count < _FEWEST:
        raise SignalError(
            f"signals of {first.time[0]:.3f}–{first.time[-1]:.3f} s and {second.time[0]:.3f}–{second.time[-1]:.3f} s "
            f"have {max(0, count)} samples in common: expected at least {_FEWEST}"
        )
    moments = begin + np.arange(count) / rate
    return rate, first.resampled(moments), second.resampled(moments)
