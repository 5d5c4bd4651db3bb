"""The DCM's plan over a sequence of footholds.

The virtual repellent point v moves piecewise linearly in time: it rests over the stance foot while the other swings,
and goes from foot to foot while both stand. Over a piece of length T, in which v goes from v₀ to v₁ at v̇ = (v₁ − v₀)/T,
the DCM that ends it at ξ_T is (Englsberger, Ott & Albu-Schäffer 2015, the solution of ξ̇ = ω·(ξ − v))

    ξ(t) = v(t) + v̇/ω + e^{ω(t − T)}·(ξ_T − v₁ − v̇/ω)

so a plan that ends at rest, ξ = v, is known backwards from its end. Where it begins is then no longer free: ξ(0)
is some weighted mean of all v to come. To begin at a given DCM all the same, the first knot after the start gives way:
ξ(0) is linear in it.
"""

from __future__ import annotations

from math import exp, hypot, inf

import numpy as np

from valor.common.arrays import FloatArray

FIRST = slice(1, 2)  # knot after the start


class DcmPlan:
    """DCM and VRP over time, from a given DCM and VRP to rest.

    Attributes:
        duration: of the plan [s].
        knots: (n+1, 3) the VRP's, the first after the start moved so that the plan begins at the DCM given [m].
    """

    def __init__(
        self,
        omega: float,
        durations: list[float],
        knots: FloatArray,
        dcm: FloatArray,
        giving: slice = FIRST,
        *,
        most: float = inf,
    ) -> None:
        """Plan.

        Args:
            omega: ω [1/s].
            durations: (n,) of the pieces, n ≥ 2, above 0 [s].
            knots: (n+1, 3) of the VRP, where the pieces begin and end [m]; the DCM rests at the last.
            dcm: (3,) at the start [m].
            giving: the knots that give way, all alike.
            most: that they may give way, in the plane [m]; what is beyond it makes the plan begin elsewhere.
        """
        self._omega = omega
        self._durations = durations
        self.duration = sum(durations)
        influence = np.zeros((len(durations) + 1, 1))
        influence[giving] = 1.0
        weight = float(self._backward(influence)[0, 0])
        self.knots = knots.copy()
        shift = (dcm - self._backward(knots)[0]) / weight
        if (length := hypot(shift[0], shift[1])) > most:
            shift[:2] *= most / length
        self.knots[giving] += shift
        self._dcm = self._backward(self.knots)
        self._piece, self._began = 0, 0.0
        self._last = len(durations) - 1

    def _backward(self, knots: FloatArray) -> FloatArray:
        """(n+1, …) the DCM at the knots, at rest at the last."""
        dcm = np.empty_like(knots)
        dcm[-1] = knots[-1]
        for i in range(len(self._durations) - 1, -1, -1):
            duration = self._durations[i]
            ahead = (knots[i + 1] - knots[i]) / (duration * self._omega)
            dcm[i] = knots[i] + ahead + exp(-self._omega * duration) * (dcm[i + 1] - knots[i + 1] - ahead)
        return dcm

    def at_end(self, piece: int) -> tuple[FloatArray, FloatArray]:
        """(3,) DCM and (3,) VRP [m] where a piece ends."""
        return self._dcm[piece + 1], self.knots[piece + 1]

    def hold(self, piece: int) -> None:
        """Let no piece begin after this one: its VRP goes on resting where it ends, and the DCM moves away from it."""
        self._last = piece

    def at(self, time: float) -> tuple[FloatArray, FloatArray]:
        """(3,) DCM and (3,) VRP [m] at ``time`` [s] since the start, which never goes back between calls."""
        while self._piece < self._last and time > self._began + self._durations[self._piece]:
            self._began += self._durations[self._piece]
            self._piece += 1
        i = self._piece
        duration = self._durations[i]
        t = min(max(time - self._began, 0.0), duration)
        if i == self._last and i < len(self._durations) - 1 and time - self._began > duration:
            vrp = self.knots[i + 1].copy()
            return vrp + exp(self._omega * (time - self._began - duration)) * (self._dcm[i + 1] - vrp), vrp
        rate = (self.knots[i + 1] - self.knots[i]) / duration
        vrp = self.knots[i] + rate * t
        ahead = rate / self._omega
        dcm = vrp + ahead + exp(self._omega * (t - duration)) * (self._dcm[i + 1] - self.knots[i + 1] - ahead)
        return dcm, vrp
