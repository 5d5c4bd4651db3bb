"""Divergent Component of Motion: the part of the CoM's motion that must be controlled.

With ω = √(g/z) the DCM is ξ = c + ċ/ω, and the CoM follows it by itself: ċ = −ω·(c − ξ). The virtual repellent point
v encodes the force on the CoM, gravity included, c̈ = ω²·(c − v), and repels the DCM: ξ̇ = ω·(ξ − v) (Englsberger, Ott &
Albu-Schäffer 2015, equations 6–16; Hopkins et al. 2014 for a time-varying ω; thesis 3.4.2). The law

    v = v_ref + (1 + k/ω)·(ξ − ξ_ref) + i,   i̇ = k_i·clip(ξ − ξ_ref)

with v_ref = ξ_ref − ξ̇_ref/ω gives the error e = ξ − ξ_ref the dynamics ė = −k·e − ω·i: it decays with k, and what the
model has wrong (masses, their places) ends in i and not in e. What is integrated is clipped, for a large error is a
push that will pass.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from motion_manager.whole_body.state import FloatArray


class DcmLaw:
    """DCM feedback with bounded integral action.

    Attributes:
        omega: ω [1/s].
        integral: (3,) i [m].
    """

    def __init__(
        self, omega: float, gain: float, integral_gain: float, integral_limit: float, integral_error: float
    ) -> None:
        """A law without a history.

        Args:
            omega: ω [1/s].
            gain: k [1/s].
            integral_gain: k_i [1/s].
            integral_limit: of each component of i [m].
            integral_error: most of each component of the error that is integrated [m].
        """
        self.omega = omega
        self._proportional = 1.0 + gain / omega
        self._integral_gain = integral_gain
        self._integral_limit = integral_limit
        self._integral_error = integral_error
        self.integral = np.zeros(3)

    @staticmethod
    def natural_frequency(height: float, gravity: float) -> float:
        """ω = √(g/z) [1/s] of a CoM ``height`` above the soles [m]."""
        return sqrt(gravity / height)

    def reset(self) -> None:
        """Forget the integral."""
        self.integral = np.zeros(3)

    def repellent_point(
        self, dcm: FloatArray, reference: FloatArray, vrp_reference: FloatArray, dt: float
    ) -> FloatArray:
        """(3,) v [m] for the DCM, its reference and the reference's VRP, (3,) in odom [m], after ``dt`` [s]."""
        error = dcm - reference
        slow = np.minimum(error, self._integral_error)
        np.maximum(slow, -self._integral_error, out=slow)
        slow *= self._integral_gain * dt
        slow += self.integral
        np.minimum(slow, self._integral_limit, out=slow)
        np.maximum(slow, -self._integral_limit, out=slow)
        self.integral = slow
        error *= self._proportional
        error += vrp_reference
        error += self.integral
        return error

    def acceleration(self, com: FloatArray, repellent_point: FloatArray) -> FloatArray:
        """(3,) c̈ = ω²·(c − v) [m/s²]."""
        result: FloatArray = (com - repellent_point) * (self.omega * self.omega)
        return result
