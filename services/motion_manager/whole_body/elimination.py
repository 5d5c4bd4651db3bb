"""Exact elimination of the accelerations: the whole-body QP in contact forces alone.

The full problem, with contact generators ρ (generalised forces Wᵀ·ρ, one generator a row of W) and pelvis rows b:

    min ½·v̇ᵀHv̇ − gᵀv̇ + ½ε‖ρ‖²   subject to   M_b·v̇ + h_b = W_bᵀ·ρ,   ρ ≥ 0,   lⱼ ≤ cⱼ·v̇ + eⱼ − sⱼ·ρ ≤ uⱼ

where each limit j is of a joint's torque (c a row of M, e = h + D·q̇, s its column of W) or of its acceleration (c a
unit row, e = 0, s = 0). Name the limited quantity yⱼ. For fixed z = (ρ, y) the accelerations solve a least-squares
problem with the equalities C·v̇ = B·z − e, where C = [M_b; c], B = [[W_bᵀ, 0], [s, 1]], e = [h_b; e]:

    v̇ = K·(g + Cᵀλ),   λ = S⁻¹·(B·z − e − C·K·g),   K = H⁻¹,   S = C·K·Cᵀ

and putting that back leaves a QP in z with simple bounds, which is feasible whatever the limits:

    min ½·(B·z − r)ᵀ·S⁻¹·(B·z − r) + ½ε‖ρ‖²,   r = e + C·K·g,   0 ≤ ρ ≤ ρ_max,   l ≤ y ≤ u

It has the full problem's optimum. Limits that the optimum keeps anyway need no y: begin with none. And where the feet
push everywhere anyway, as under a robot at rest, ρ ≥ 0 is none either, and six equations are all that is left:

    ρ = Bᵀ·μ,   (B·Bᵀ + ε·S)·μ = r,   λ = −ε·μ
"""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotrs

from motion_manager.whole_body.state import FloatArray

FORCE_REGULARIZATION = 1e-4  # ε [1/N²·(objective's unit)]
VALUE_REGULARIZATION = 1e-9  # of y: S⁻¹ makes it definite already, this keeps round-off from undoing it


class UnsolvableError(ArithmeticError):
    """The problem of this period has no solution: numbers that are not finite, or limits that cross."""


class Limit(NamedTuple):
    """Rows of limited quantities y = c·v̇ + e − s·ρ."""

    rows: FloatArray  # (k, nv) c
    offset: FloatArray  # (k,) e
    forces: FloatArray  # (k, nρ) s


class Elimination:
    """K, and from it the reduced QP for a set of limits."""

    def __init__(self, hessian: FloatArray, gradient: FloatArray) -> None:
        """Factorise H.

        Args:
            hessian: (nv, nv) symmetric positive definite.
            gradient: (nv,).

        Raises:
            UnsolvableError: H is not positive definite.
        """
        self._factor, info = dpotrf(hessian.T, lower=1, clean=0)  # as LAPACK has it, down columns
        if info != 0:
            raise UnsolvableError("the objective's Hessian is not positive definite")
        self._gradient = gradient
        self._response: tuple[FloatArray, FloatArray] | None = None  # of the pelvis rows alone

    def unbounded(self, mass_rows: FloatArray, bias: FloatArray, forces: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(nρ,) ρ and (nv,) v̇ of the problem without a limit, not even ρ ≥ 0; not finite where there is none.

        Args:
            mass_rows: (6, nv) M_b.
            bias: (6,) h_b.
            forces: (nρ, nv) W.
        """
        solved, products = self._response = self._respond(mass_rows)
        base = forces[:, :6]
        system = np.dot(base.T, base)
        system += FORCE_REGULARIZATION * products[:, :6]
        _, multiplier, info = dposv(system, products[:, 6] + bias, lower=1, overwrite_a=1, overwrite_b=1)
        if info != 0:
            multiplier.fill(np.nan)
        acceleration = solved[:, :6] @ (-FORCE_REGULARIZATION * multiplier)
        acceleration += solved[:, 6]
        return base @ multiplier, acceleration

    def _respond(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(nv, n+1) K·[Cᵀ, g] and (n, n+1) C·K·[Cᵀ, g], for n rows C."""
        n = rows.shape[0]
        right = np.empty((self._gradient.shape[0], n + 1), order="F")
        right[:, :n] = rows.T
        right[:, n] = self._gradient
        solved, _ = dpotrs(self._factor, right, lower=1, overwrite_b=1)
        return solved, rows @ solved

    def reduce(
        self, mass_rows: FloatArray, bias: FloatArray, forces: FloatArray, limit: Limit | None = None
    ) -> Reduced:
        """The reduced QP.

        Args:
            mass_rows: (6, nv) M_b.
            bias: (6,) h_b.
            forces: (nρ, nv) W.
            limit: quantities to bound, or None.

        Raises:
            UnsolvableError: the rows are not independent or not finite.
        """
        base = forces[:, :6].T
        count = forces.shape[0]
        if limit is None:
            rows, offset, effect = mass_rows, bias, base
        else:
            k = limit.rows.shape[0]
            rows = np.concatenate((mass_rows, limit.rows))
            offset = np.concatenate((bias, limit.offset))
            effect = np.zeros((6 + k, count + k))
            effect[:6, :count] = base
            effect[6:, :count] = limit.forces
            effect[range(6, 6 + k), range(count, count + k)] = 1.0
        n = rows.shape[0]
        solved, products = (self._response if limit is None else None) or self._respond(rows)
        compliance, info = dpotrf(products[:, :n], lower=1, clean=0)
        if info != 0:
            raise UnsolvableError("the constraints are not independent")
        right = np.empty((n, effect.shape[1] + 1), order="F")
        right[:, :-1] = effect
        np.add(products[:, n], offset, out=right[:, -1])  # r
        scaled, _ = dpotrs(compliance, right, lower=1, overwrite_b=1)  # S⁻¹·[B, r]
        objective = effect.T @ scaled  # Bᵀ·S⁻¹·[B, r]
        hessian, gradient = objective[:, :-1].copy(), np.negative(objective[:, -1])
        diagonal = hessian.ravel()[:: hessian.shape[0] + 1]  # a view
        diagonal[:count] += FORCE_REGULARIZATION
        if limit is not None:
            diagonal[count:] += VALUE_REGULARIZATION
        if not isfinite(gradient @ gradient):  # LAPACK lets NaN pass, and here it has reached every number
            raise UnsolvableError("the problem is not finite")
        return Reduced(hessian, gradient, solved, scaled)


class Reduced(NamedTuple):
    """min ½·zᵀ·hessian·z + gradientᵀ·z, and the way back to v̇."""

    hessian: FloatArray  # (nz, nz)
    gradient: FloatArray  # (nz,)
    solved: FloatArray  # (nv, n+1) K·[Cᵀ, g]
    scaled: FloatArray  # (n, nz+1) S⁻¹·[B, r]

    def acceleration(self, z: FloatArray) -> FloatArray:
        """(nv,) v̇ = K·(g + Cᵀλ)."""
        multiplier = self.scaled[:, :-1] @ z - self.scaled[:, -1]
        result: FloatArray = self.solved[:, -1] + self.solved[:, :-1] @ multiplier
        return result
