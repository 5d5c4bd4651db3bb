"""Splines between states."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import Indices

_SAMPLES = 33  # per segment
_CHUNK = 64  # segments sampled at once: bounds the memory


def spline(start: FloatArray, end: FloatArray, duration: FloatArray, order: Indices) -> FloatArray:
    """Coefficients of the polynomials between pairs of states.

    Args:
        start: (3, k, m) position, velocity and acceleration.
        end: (3, k, m).
        duration: (k,) [s], positive.
        order: (k,) 1 linear, 3 cubic, 5 quintic; higher derivatives are ignored.

    Returns:
        (k, 6, m) lowest power first, in time since the start of the segment [s].
    """
    (p0, v0, a0), (p1, v1, a1) = start, end
    T = duration[:, None]
    c = np.zeros((len(duration), 6, p0.shape[1]))
    with np.errstate(all="ignore"):  # overflow is detected by the limits
        distance = p1 - p0
        c[:, 0] = p0
        linear, cubic, quintic = order == 1, order == 3, order == 5
        c[linear, 1] = (distance / T)[linear]
        c[cubic, 1] = v0[cubic]
        c[cubic, 2] = ((3 * distance - (2 * v0 + v1) * T) / T**2)[cubic]
        c[cubic, 3] = ((-2 * distance + (v0 + v1) * T) / T**3)[cubic]
        c[quintic, 1] = v0[quintic]
        c[quintic, 2] = (0.5 * a0)[quintic]
        c[quintic, 3] = ((20 * distance - (12 * v0 + 8 * v1) * T - (3 * a0 - a1) * T**2) / (2 * T**3))[quintic]
        c[quintic, 4] = ((-30 * distance + (16 * v0 + 14 * v1) * T + (3 * a0 - 2 * a1) * T**2) / (2 * T**4))[quintic]
        c[quintic, 5] = ((12 * distance - 6 * (v0 + v1) * T - (a0 - a1) * T**2) / (2 * T**5))[quintic]
    return c


def _powers(time: FloatArray) -> FloatArray:
    """(3, …, 6) powers of time for position, and their derivatives for velocity and acceleration."""
    ones = np.ones_like(time)
    zeros = 0.0 * time
    position = np.stack([ones, time, time**2, time**3, time**4, time**5], axis=-1)
    velocity = np.stack([zeros, ones, 2 * time, 3 * time**2, 4 * time**3, 5 * time**4], axis=-1)
    acceleration = np.stack([zeros, zeros, 2 * ones, 6 * time, 12 * time**2, 20 * time**3], axis=-1)
    return np.stack([position, velocity, acceleration])


def sampled(coefficients: FloatArray, duration: FloatArray) -> Iterator[tuple[int, FloatArray, FloatArray, FloatArray]]:
    """Samples of splines (k, 6, m) of durations (k,) [s], some segments at a time.

    Yields number of the first segment, (c, s, m) positions, (c, m) maximum speeds and accelerations.
    """
    fractions = np.linspace(0.0, 1.0, _SAMPLES)
    for first in range(0, len(duration), _CHUNK):
        chunk = slice(first, first + _CHUNK)
        with np.errstate(all="ignore"):
            positions, *rates = _powers(duration[chunk, None] * fractions) @ coefficients[chunk]
            speeds, accelerations = (np.abs(rate).max(axis=1) for rate in rates)
        yield first, positions, speeds, accelerations
