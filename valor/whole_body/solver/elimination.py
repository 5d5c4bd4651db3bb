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

from collections.abc import Sequence
from math import isfinite
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotrs

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel
from valor.whole_body.constraints.limit import Limit

FORCE_REGULARIZATION = 1e-4  # ε [1/N²·(objective's unit)]
VALUE_REGULARIZATION = 1e-9  # of y: S⁻¹ makes it definite already, this keeps round-off from undoing it


class UnsolvableError(ArithmeticError):
    """The problem of this period has no solution: numbers that are not finite, or limits that cross."""


class Elimination:
    """K, and from it the reduced QP for a set of limits; one period after another."""

    def __init__(self, nv: int) -> None:
        """Of a model with ``nv`` degrees of freedom."""
        self._right = np.zeros((7, nv))  # M_b, then g
        self._products, self._squares, self._bias = np.zeros((6, 7)), np.zeros((6, 6)), np.zeros(6)
        self._multiplier, self._shares = np.zeros(6), np.zeros(7)
        self._factor, self._solved = np.zeros((nv, nv)), np.zeros((nv, 7))
        self._rows, self._gradient = np.zeros((6, nv)), np.zeros(nv)
        self._solve = Kernel(
            "multipliers",
            _multipliers,
            (self._products, self._squares, self._bias),
            (self._multiplier, self._shares),
        )

    def factorize(self, hessian: FloatArray, gradient: FloatArray, mass_rows: FloatArray, bias: FloatArray) -> None:
        """Begin a period.

        Args:
            hessian: (nv, nv) symmetric positive definite.
            gradient: (nv,).
            mass_rows: (6, nv) M_b.
            bias: (6,) h_b.

        Raises:
            UnsolvableError: H is not positive definite.
        """
        right = self._right
        right[:6], right[6], self._bias[:] = mass_rows, gradient, bias
        # As LAPACK has them, down columns. The factor and what it is for are had in one call.
        self._factor, self._solved, info = dposv(hessian.T, right.T, lower=1, overwrite_b=1)
        if info != 0:
            raise UnsolvableError("the objective's Hessian is not positive definite")
        self._rows, self._gradient = mass_rows, gradient
        np.dot(mass_rows, self._solved, self._products)

    def unbounded(self, forces: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(nρ,) ρ and (nv,) v̇ of the problem without a limit, not even ρ ≥ 0; not finite where there is none.

        Args:
            forces: (nρ, nv) W.
        """
        base = forces[:, :6]
        np.dot(base.T, base, self._squares)
        self._solve()
        return base @ self._multiplier, self._solved @ self._shares

    def _respond(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(nv, n+1) K·[Cᵀ, g] and (n, n+1) C·K·[Cᵀ, g], for n rows C."""
        right = np.concatenate((rows, self._gradient[None]))
        solved, _ = dpotrs(self._factor, right.T, lower=1, overwrite_b=1)
        return solved, rows @ solved

    def reduce(self, forces: FloatArray, limit: Limit | None = None) -> Reduced:
        """The reduced QP.

        Args:
            forces: (nρ, nv) W.
            limit: quantities to bound, or None.

        Raises:
            UnsolvableError: the rows are not independent or not finite.
        """
        base = forces[:, :6].T
        count = forces.shape[0]
        if limit is None:
            offset, effect = self._bias, base
            solved, products = self._solved, self._products
        else:
            k = limit.rows.shape[0]
            solved, products = self._respond(np.concatenate((self._rows, limit.rows)))
            offset = np.concatenate((self._bias, limit.offset))
            effect = np.zeros((6 + k, count + k))
            effect[:6, :count] = base
            effect[6:, :count] = limit.forces
            effect[range(6, 6 + k), range(count, count + k)] = 1.0
        n = products.shape[0]
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


def _multipliers(products: Expression, squares: Expression, bias: Expression) -> Sequence[Expression]:
    """(6,) μ, and (7,) what it makes of K·[Cᵀ, g]: λ and 1."""
    factor = ca.chol(squares + FORCE_REGULARIZATION * products[:, :6])  # no number where there is none
    multiplier = ca.solve(factor, ca.solve(factor.T, products[:, 6] + bias))
    return multiplier, ca.vertcat(-FORCE_REGULARIZATION * multiplier, 1.0)
