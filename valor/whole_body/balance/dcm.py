"""Divergent Component of Motion: the part of the CoM's motion that must be controlled.

With ω = √(g/z) the DCM is ξ = c + ċ/ω, and the CoM follows it by itself: ċ = −ω·(c − ξ). The virtual repellent point
v encodes the force on the CoM, gravity included, c̈ = ω²·(c − v), and repels the DCM: ξ̇ = ω·(ξ − v) (Englsberger, Ott &
Albu-Schäffer 2015, equations 6–16; Hopkins et al. 2014 for a time-varying ω; thesis 3.4.2). The law

    v = v_ref + (1 + k/ω)·(ξ − ξ_ref) + i,   i̇ = k_i·clip(ξ − ξ_ref)

with v_ref = ξ_ref − ξ̇_ref/ω gives the error e = ξ − ξ_ref the dynamics ė = −k·e − ω·i: it decays with k, and what the
model has wrong (masses, their places) ends in i and not in e. What is integrated is clipped, for a large error is a
push that will pass. But it passes only if the CoP is soon at the sole's edge, where k alone leads it at an error of
5 cm: what of e is beyond a threshold in the plane has a higher gain. No more acceleration is asked for than
the soles' friction gives under the robot's weight: for more, the QP would press on the ground, and the robot rise.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt

import casadi as ca

from valor.common.kernel import Expression, clipped


@dataclass(frozen=True, slots=True)
class DcmLaw:
    """DCM feedback with bounded integral action, on expressions."""

    omega: float  # ω [1/s]
    gain: float  # k [1/s]
    integral_gain: float  # k_i [1/s]
    integral_limit: float  # of each component of i [m]
    integral_error: float  # most of each component of the error that is integrated [m]
    push_gain: float = 0.0  # added to k for what of the error is beyond … [1/s]
    push_error: float = 0.0  # … this, in the plane [m]
    grip: float = inf  # most that is asked for in the plane [m/s²]

    @staticmethod
    def natural_frequency(height: float, gravity: float) -> float:
        """ω = √(g/z) [1/s] of a CoM ``height`` above the soles [m]."""
        return sqrt(gravity / height)

    def repellent_point(
        self, dcm: Expression, reference: Expression, vrp_reference: Expression, integral: Expression, dt: Expression
    ) -> tuple[Expression, Expression]:
        """(3,) v and (3,) i [m] for the DCM, its reference and the reference's VRP, (3,) in odom [m], after ``dt`` [s].

        ``integral`` is i before.
        """
        error = dcm - reference
        slow = clipped(error, -self.integral_error, self.integral_error)
        integral = integral + self.integral_gain * dt * slow
        integral = clipped(integral, -self.integral_limit, self.integral_limit)
        size = _in_plane(error)
        beyond = ca.if_else(size > self.push_error, 1.0 - self.push_error / size, 0.0)
        pushed = ca.vertcat(error[:2], 0.0) * beyond
        proportional = (1.0 + self.gain / self.omega) * error + self.push_gain / self.omega * pushed
        return vrp_reference + proportional + integral, integral

    def acceleration(self, com: Expression, repellent_point: Expression) -> Expression:
        """(3,) c̈ = ω²·(c − v) [m/s²], in the plane no more than ``grip``: beyond friction it would be had by a leap."""
        wanted = (com - repellent_point) * (self.omega * self.omega)
        size = _in_plane(wanted)
        share = ca.if_else(size > self.grip, self.grip / size, 1.0)
        return ca.vertcat(share * wanted[:2], wanted[2])


def _in_plane(vector: Expression) -> Expression:
    """Length of (3,) in the plane."""
    return ca.sqrt(vector[0] * vector[0] + vector[1] * vector[1])
