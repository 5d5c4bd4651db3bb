"""Natural frequency ω of the DCM over a plan: constant, or varying with the planned height of the CoM.

A CoM at height z, with the CoP at height p, moves as ẍ = λ·(x − x_p) with λ = (z̈ + g)/(z − p). The DCM ξ = x + ẋ/ω
diverges from the VRP v = x − ẍ/λ as

    ξ̇ = (ω − ω̇/ω)·(ξ − v)      if      ω̇ = ω² − λ

(Hopkins, Hong & Leonessa 2014, "Humanoid locomotion on uneven terrain using the time-varying divergent component of
motion"). This Riccati equation is stable backwards from √(g/(z − p)) at rest. By ω = −ẏ/y it is linear, ÿ = λ·y, and
its decaying solution y also solves the DCM: over a piece with the VRP at a constant rate v̇, the DCM that ends at ξ_T is

    ξ(t) = v(t) + v̇·(y(t) − y(T))/(−ẏ(t)) + (ξ_T − v_T)·ẏ(T)/ẏ(t)

y = e^{−ωt} if λ is constant. Vertically λ is constant also if z follows a DCM plan with a constant ω.
"""

from bisect import bisect
from collections.abc import Sequence
from math import ceil, cosh, exp, factorial, sinh, sqrt

import numpy as np

from valor.common.arrays import FloatArray

GRID = 0.04  # Longest interval with a constant λ [s]
STEEPEST = 2.0  # Largest factor of λ at rest, up or down
INSTANT = 1e-6  # Shortest span with a quotient of differences [s]


class NaturalFrequency:
    """Constant ω."""

    def __init__(self, omega: float) -> None:
        """Args: omega: ω [1/s]."""
        self._omega = omega

    def at(self, time: float) -> tuple[float, float]:
        """Return ω [1/s] and ω̇ [1/s²] at ``time`` [s] since the start of the plan."""
        return self._omega, 0.0

    def over(self, time: float, duration: float) -> tuple[float, float]:
        """Return (ẏ(T) − ẏ(t))/(y(t) − y(T)) [1/s] and ẏ(T)/ẏ(t) of a span from t to T, both [s]."""
        return self._omega, exp(-self._omega * duration)

    def set_heights(self, time: float, dcm: FloatArray, vrp: FloatArray) -> None:
        """Replace the heights of (3,) DCM and (3,) VRP by those of the CoM's planned motion, if there is one."""


class VaryingFrequency(NaturalFrequency):
    """ω for a CoM that passes through given heights with the least jerk."""

    def __init__(
        self,
        gravity: float,
        times: FloatArray,
        ground: FloatArray,
        points: Sequence[tuple[float, float]],
        begin: tuple[float, float, float],
    ) -> None:
        """Solve the Riccati equation.

        Args:
            gravity: g [m/s²].
            times: (k,) from 0 to the end of the plan [s].
            ground: (k,) height of the CoP at these times, linear between them [m].
            points: times [s] and heights of the CoM [m] after the start; at the last, at the end, it rests.
            begin: height [m], velocity [m/s] and acceleration [m/s²] of the CoM at the start.
        """
        self._passed = [0.0, *(time for time, _ in points)]
        self._way = _least_jerk(self._passed, [height for _, height in points], begin)
        duration = self._passed[-1]
        count = ceil(duration / GRID)
        self._step = duration / count
        middles = self._step * (np.arange(count) + 0.5)
        heights, _, accelerations = np.array([self._height(time) for time in middles.tolist()]).T
        rest = gravity / (points[-1][1] - float(ground[-1]))
        above = np.maximum(heights - np.interp(middles, times, ground), gravity / (STEEPEST * rest))
        stiffness = np.clip((gravity + accelerations) / above, rest / STEEPEST, rest * STEEPEST)
        self._stiffness: list[float] = stiffness.tolist()  # λ in each interval [1/s²]
        self._solution = [(1.0, -sqrt(rest))] * (count + 1)  # y, ẏ at its ends
        for i in range(count - 1, -1, -1):
            self._solution[i] = self._solved(i, self._step)

    def at(self, time: float) -> tuple[float, float]:
        y, rate = self._decay(time)
        omega = -rate / y
        return omega, omega * omega - self._stiffness[self._interval(time)]

    def over(self, time: float, duration: float) -> tuple[float, float]:
        if duration < INSTANT:
            return self.at(time)[0], 1.0
        (y, rate), (last, last_rate) = self._decay(time), self._decay(time + duration)
        return (last_rate - rate) / (y - last), last_rate / rate

    def set_heights(self, time: float, dcm: FloatArray, vrp: FloatArray) -> None:
        height, velocity, acceleration = self._height(time)
        dcm[2] = height + velocity / self.at(time)[0]
        vrp[2] = height - acceleration / self._stiffness[self._interval(time)]

    def _interval(self, time: float) -> int:
        return min(int(time / self._step), len(self._stiffness) - 1)

    def _decay(self, time: float) -> tuple[float, float]:
        """Return y and ẏ."""
        i = self._interval(time)
        return self._solved(i, (i + 1) * self._step - time)

    def _solved(self, interval: int, left: float) -> tuple[float, float]:
        """Return y and ẏ, ``left`` [s] before the end of an interval."""
        root = sqrt(self._stiffness[interval])
        c, s = cosh(root * left), sinh(root * left)
        y, rate = self._solution[interval + 1]
        return c * y - s / root * rate, c * rate - s * root * y

    def _height(self, time: float) -> tuple[float, float, float]:
        """Return height [m], velocity [m/s] and acceleration [m/s²] of the CoM."""
        i = min(bisect(self._passed, time), len(self._way)) - 1
        a, b, c, d, e, f = self._way[i]
        t = time - self._passed[i]
        return (
            a + t * (b + t * (c + t * (d + t * (e + t * f)))),
            b + t * (2.0 * c + t * (3.0 * d + t * (4.0 * e + t * 5.0 * f))),
            2.0 * c + t * (6.0 * d + t * (12.0 * e + t * 20.0 * f)),
        )


def _least_jerk(times: list[float], heights: list[float], begin: tuple[float, float, float]) -> list[list[float]]:
    """Return the coefficients of the quintic spline through n heights at ``times``[1:], from ``begin`` to rest."""
    n = len(heights)
    matrix, right = np.zeros((6 * n, 6 * n)), np.zeros(6 * n)
    matrix[:3, :6], right[:3] = _derivatives(0.0)[:3], begin
    row = 3
    for i, height in enumerate(heights):
        end, piece = _derivatives(times[i + 1] - times[i]), slice(6 * i, 6 * i + 6)
        matrix[row, piece], right[row] = end[0], height
        if i == n - 1:
            matrix[row + 1 : row + 3, piece] = end[1:3]
        else:  # value and four derivatives continue
            matrix[row + 1 : row + 6, piece] = end[:5]
            matrix[row + 1 : row + 6, 6 * i + 6 : 6 * i + 12] = -_derivatives(0.0)[:5]
        row += 6
    found: list[list[float]] = np.linalg.solve(matrix, right).reshape(n, 6).tolist()
    return found


def _derivatives(time: float) -> FloatArray:
    """(6, 6) derivatives 0 to 5 of the monomials 1 to t⁵."""
    return np.array(
        [[factorial(k) // factorial(k - d) * time ** (k - d) if k >= d else 0.0 for k in range(6)] for d in range(6)]
    )
