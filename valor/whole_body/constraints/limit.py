"""What a limit of the QP is: quantities y = c·v̇ + e − s·ρ of accelerations and contact forces, between bounds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression
from valor.whole_body.model.dynamics import Dynamics


class Limit(NamedTuple):
    """Rows of limited quantities y = c·v̇ + e − s·ρ."""

    rows: FloatArray  # (k, nv) c
    offset: FloatArray  # (k,) e
    forces: FloatArray  # (k, nρ) s


class Solved(NamedTuple):
    """A solution without these limits, of the model's joints, as expressions."""

    inertial: Expression  # (nj,) M·v̇ [N·m]
    bias: Expression  # (nj,) h [N·m]
    contact: Expression  # (nj,) torque of the contact forces [N·m]
    velocity: Expression  # (nj,) q̇ [rad/s]
    acceleration: Expression  # (nj,) q̈ [rad/s²]


class JointLimit(ABC):
    """A limit of every joint. Which of them matter is known when the problem has been solved without."""

    @abstractmethod
    def value(self, solved: Solved) -> Expression:
        """(nj,) y."""

    @abstractmethod
    def rows(self, dynamics: Dynamics, forces: FloatArray, joints: npt.NDArray[np.intp]) -> Limit:
        """Of some joints.

        Args:
            dynamics: at this state.
            forces: (nρ, nv) generalised forces of the generators.
            joints: (k,) of the model's joints.
        """
