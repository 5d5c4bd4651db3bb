"""What the motors can give: torques within the effort limits.

    τ = M_j·v̇ + h_j + D·q̇ − (Wᵀ·ρ)_j,   |τ| ≤ τ_max

with j the joints' rows of the equations of motion, D their viscous damping and Wᵀ·ρ the contact forces.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression
from valor.whole_body.constraints.limit import JointLimit, Limit, Solved
from valor.whole_body.model.dynamics import Dynamics


class TorqueLimits(JointLimit):
    """τ [N·m]."""

    def __init__(self, damping: FloatArray) -> None:
        """Args: damping: (nj,) D [N·m·s/rad]."""
        self._damping = damping

    def value(self, solved: Solved) -> Expression:
        """(nj,) τ."""
        return solved.inertial + solved.bias + ca.DM(self._damping) * solved.velocity - solved.contact

    def rows(self, dynamics: Dynamics, forces: FloatArray, joints: npt.NDArray[np.intp]) -> Limit:
        """Of some joints."""
        offset = dynamics.bias[6:] + self._damping * dynamics.joint_velocity
        return Limit(dynamics.mass_matrix[6 + joints], offset[joints], forces[:, 6 + joints].T)
