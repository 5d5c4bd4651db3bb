"""DCM plan over a sequence of footholds.

The virtual repellent point v moves piecewise linearly in time: it rests over the stance foot during a swing and moves
from foot to foot in double support. Over a piece of length T, with v from v₀ to v₁ at v̇ = (v₁ − v₀)/T, the DCM that
ends it at ξ_T is, for a constant ω (Englsberger, Ott & Albu-Schäffer 2015, the solution of ξ̇ = ω·(ξ − v))

    ξ(t) = v(t) + v̇/ω + e^{ω(t − T)}·(ξ_T − v₁ − v̇/ω)

A plan that ends at rest, ξ = v, is thus computed backwards, and its start ξ(0) is a weighted mean of all later v. To
start at a given DCM, the first knot after the start is displaced: ξ(0) is linear in it. With a varying ω, ``frequency``
has the two numbers of this solution and the heights of ξ and v; plane and height are then separate.
"""

from itertools import accumulate
from math import exp, hypot, inf

import numpy as np

from valor.common.arrays import FloatArray
from valor.whole_body.walking.frequency import NaturalFrequency

FIRST = slice(1, 2)  # Knot after the start


class DcmPlan:
    """DCM and VRP over time, from a given DCM and VRP to rest."""

    def __init__(
        self,
        frequency: NaturalFrequency,
        durations: list[float],
        knots: FloatArray,
        dcm: FloatArray,
        giving: slice = FIRST,
        *,
        most: float = inf,
    ) -> None:
        """Plan for ω over the plan's time, from (3,) the DCM at the start [m].

        ``durations`` (n,) of the pieces, n ≥ 2, above 0 [s], have (n+1, 3) VRP ``knots`` at their ends [m]; the DCM
        rests at the last. The knots ``giving`` are displaced, all alike, in the plane by at most ``most`` [m]; for more
        the plan starts at another DCM.
        """
        self._frequency = frequency
        self._durations = durations
        self.duration = sum(durations)  # duration of the plan [s]
        times = [0.0, *accumulate(durations)]
        self._spans = [frequency.over(times[i], duration) for i, duration in enumerate(durations)]
        influence = np.zeros((len(durations) + 1, 1))
        influence[giving] = 1.0
        weight = float(self._backward(influence)[0, 0])
        self.knots = knots.copy()  # (n+1, 3) VRP, displaced so that the plan starts at the given DCM [m]
        shift = (dcm - self._backward(knots)[0]) / weight
        if (length := hypot(shift[0], shift[1])) > most:
            shift[:2] *= most / length
        self.knots[giving] += shift
        self._dcm = self._backward(self.knots)
        for each in zip(times, self._dcm, self.knots, strict=True):
            frequency.set_heights(*each)
        self.omega, self.omega_dot = frequency.at(0.0)  # ω [1/s] and ω̇ [1/s²] at the latest time of ``at``
        self._piece, self._began = 0, 0.0
        self._last = len(durations) - 1

    def _backward(self, knots: FloatArray) -> FloatArray:
        """(n+1, …) DCM at the knots, at rest at the last."""
        dcm = np.empty_like(knots)
        dcm[-1] = knots[-1]
        for i in range(len(self._durations) - 1, -1, -1):
            omega, decay = self._spans[i]
            ahead = (knots[i + 1] - knots[i]) / (self._durations[i] * omega)
            dcm[i] = knots[i] + ahead + decay * (dcm[i + 1] - knots[i + 1] - ahead)
        return dcm

    def at_end(self, piece: int) -> tuple[FloatArray, FloatArray]:
        """Return (3,) DCM and (3,) VRP [m] at the end of a piece."""
        return self._dcm[piece + 1], self.knots[piece + 1]

    def hold(self, piece: int) -> None:
        """Start no piece after this one: VRP and ω rest at its end, and the DCM diverges from there."""
        self._last = piece

    def at(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return (3,) DCM and (3,) VRP [m] at ``time`` [s] since the start; it must not decrease between calls."""
        while self._piece < self._last and time > self._began + self._durations[self._piece]:
            self._began += self._durations[self._piece]
            self._piece += 1
        i = self._piece
        duration = self._durations[i]
        t = min(max(time - self._began, 0.0), duration)
        now = self._began + t
        self.omega, self.omega_dot = self._frequency.at(now)
        if i == self._last and i < len(self._durations) - 1 and time - self._began > duration:
            self.omega_dot = 0.0
            vrp = self.knots[i + 1].copy()
            return vrp + exp(self.omega * (time - self._began - duration)) * (self._dcm[i + 1] - vrp), vrp
        rate = (self.knots[i + 1] - self.knots[i]) / duration
        vrp = self.knots[i] + rate * t
        omega, decay = self._frequency.over(now, duration - t)
        ahead = rate / omega
        dcm = vrp + ahead + decay * (self._dcm[i + 1] - self.knots[i + 1] - ahead)
        self._frequency.set_heights(now, dcm, vrp)
        return dcm, vrp
