"""The QP of a control period: contact forces and accelerations, solved by DAQP in the reduced form.

DAQP (Arnström, Bemporad & Axehill 2022) is a dual active-set method; it is called natively. Limits of joints join the
problem only when its solution without them breaks them, one round after another until none is broken. A foot that shall
not push is no part of the problem at all. And while no generator is at a bound, as nearly always when the robot stands,
the optimum without bounds is the optimum: it is tried first when it was so in the period before, and needs no solver.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import casadi as ca
import daqp
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel
from valor.whole_body.constraints.contact import UNBOUNDED
from valor.whole_body.constraints.limit import JointLimit, Limit, Solved
from valor.whole_body.model.dynamics import Dynamics
from valor.whole_body.solver.elimination import Elimination, Reduced, UnsolvableError
from valor.whole_body.solver.objective import Objective
from valor.whole_body.state import QpStatus

ROUNDS = 8  # of limits joining the problem
TOLERANCE = 1e-6  # of a limit [N·m, rad/s²]


@dataclass(slots=True)
class Bounds:
    """Limits in this period: of every joint, one kind after another; then ``others``."""

    lower: FloatArray  # (kinds·nj + k,)
    upper: FloatArray  # (kinds·nj + k,)
    others: Limit | None = None  # k more, of accelerations alone


@dataclass(slots=True)
class Solution:
    """The optimum."""

    acceleration: FloatArray  # (nv,) v̇
    rho: FloatArray  # (nρ,) forces along the generators [N]
    torque: FloatArray  # (nj,) [N·m]
    status: QpStatus
    limits: npt.NDArray[np.intp]  # which of the bounds joined the problem


class ContactForceQp:
    """Solves for contact forces and accelerations."""

    def __init__(self, generators: int, joints: int, limits: Sequence[JointLimit]) -> None:
        """A problem with nothing bound.

        Args:
            generators: nρ.
            joints: nj.
            limits: of every joint; the first is of the torques.
        """
        self._generators = generators
        self._joints, self._limits = joints, limits
        self._bounded = len(limits) * joints
        self._none = np.zeros(0, dtype=np.intp)
        n = self._joints
        self._elimination = Elimination(6 + n)
        self._given = np.zeros((5 + 2 * len(limits), n))
        self._values, self._excess = np.zeros(self._bounded), np.zeros(2)
        self._pushes_freely = True  # whether no generator was at a bound in the period before
        self._check = Kernel("limits", self._expressions, (self._given,), (self._values, self._excess))
        self.limit_forces(np.full(generators, UNBOUNDED))

    def limit_forces(self, upper: FloatArray) -> None:
        """From now on: (nρ,) upper bounds [N]; 0 for the generators of a foot that shall not push."""
        pushing = np.flatnonzero(upper)  # contiguous, as each foot's are
        self._pushing = slice(int(pushing[0]), int(pushing[-1]) + 1) if pushing.size else slice(None)
        self._upper = upper[self._pushing]
        self._lower = np.zeros(self._upper.size)
        self._upper_bounded = bool((self._upper < UNBOUNDED).any())
        self._no_rows = np.empty((0, self._upper.size))

    def solve(self, objective: Objective, dynamics: Dynamics, forces: FloatArray, bounds: Bounds) -> Solution:
        """Solve.

        Args:
            objective: updated at this state.
            dynamics: at this state.
            forces: (nρ, nv) generalised forces of the generators.
            bounds: of torque and acceleration.

        Raises:
            UnsolvableError: numbers that are not finite, limits that cross, or the solver gave up.
        """
        mass, bias, n, pushing = dynamics.mass_matrix, dynamics.bias, self._joints, self._pushing
        forces = forces[pushing]
        elimination = self._elimination
        elimination.factorize(objective.hessian, objective.gradient, mass[:6], bias[:6])
        joined, others = self._none, bounds.others
        for _ in range(ROUNDS):
            limit = self._limit(dynamics, forces, joined, others) if joined.size else None
            free = self._free(forces) if limit is None and self._pushes_freely else None
            if free is None:
                reduced = elimination.reduce(forces, limit)
                z = self._minimum(reduced, bounds, joined)
                acceleration, pushes = reduced.acceleration(z), z[: self._upper.size]
                if limit is None:
                    self._pushes_freely = self._within(pushes)
            else:
                pushes, acceleration = free
            np.concatenate(
                (
                    mass[6:] @ acceleration,
                    bias[6:],
                    dynamics.joint_velocity,
                    pushes @ forces[:, 6:],
                    acceleration[6:],
                    bounds.lower[: self._bounded],
                    bounds.upper[: self._bounded],
                ),
                out=self._given.reshape(-1),
            )
            self._check()
            values = self._values.copy()
            excess, squares = self._excess.tolist()
            if not isfinite(squares):  # DAQP lets NaN pass, and the largest of some numbers does not show it
                raise UnsolvableError("the solution is not finite")
            if others is not None:
                values = np.concatenate((values, others.rows @ acceleration + others.offset))
            status = QpStatus.LIMITED if joined.size else QpStatus.OPTIMAL
            if excess > TOLERANCE or others is not None:
                broken = (values > bounds.upper + TOLERANCE) | (values < bounds.lower - TOLERANCE)
                broken[joined] = False  # what is left there is round-off
                if broken.any():
                    joined = np.concatenate((joined, np.flatnonzero(broken)))
                    continue
            return Solution(acceleration, self._all(pushes), values[:n], status, joined)
        raise UnsolvableError(f"limits of joints kept breaking after {ROUNDS} rounds")

    def _expressions(self, given: Expression) -> Sequence[Expression]:
        """Values of all limits; (2,) how far the worst of them is beyond its bounds, and all squared."""
        inertial, bias, velocity, contact, acceleration = (given[i, :].T for i in range(5))
        solved = Solved(inertial, bias, contact, velocity, acceleration)
        values = ca.vertcat(*(limit.value(solved) for limit in self._limits))
        kinds = len(self._limits)
        lower, upper = (ca.vec(given[i : i + kinds, :].T) for i in (5, 5 + kinds))
        excess = functools.reduce(ca.fmax, ca.vertsplit(ca.fmax(values - upper, lower - values)))
        return values, ca.vertcat(excess, ca.sumsqr(values))

    def _free(self, forces: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Forces along the pushing generators and accelerations, if no bound of the forces makes any difference."""
        found = self._elimination.unbounded(forces)
        return found if self._within(found[0]) else None

    def _within(self, pushes: FloatArray) -> bool:
        """Whether forces are within their bounds, and numbers."""
        numbers = pushes.tolist()  # Python finds the least of thirty numbers before NumPy has begun
        return (
            min(numbers) > 0.0
            and isfinite(sum(numbers))
            and not (self._upper_bounded and bool((pushes >= self._upper).any()))
        )

    def _all(self, pushes: FloatArray) -> FloatArray:
        """(nρ,) of both feet."""
        rho = np.zeros(self._generators)
        rho[self._pushing] = pushes
        return rho

    def _limit(
        self, dynamics: Dynamics, forces: FloatArray, joined: npt.NDArray[np.intp], others: Limit | None
    ) -> Limit:
        rows, constant, effect = (
            np.zeros((joined.size, self._joints + 6)),
            np.zeros(joined.size),
            np.zeros((joined.size, self._upper.size)),
        )
        for kind, limit in enumerate(self._limits):
            chosen = (joined >= kind * self._joints) & (joined < (kind + 1) * self._joints)
            part = limit.rows(dynamics, forces, joined[chosen] - kind * self._joints)
            rows[chosen], constant[chosen], effect[chosen] = part
        if others is not None:
            more = joined >= self._bounded
            rows[more] = others.rows[joined[more] - self._bounded]
            constant[more] = others.offset[joined[more] - self._bounded]
        return Limit(rows, constant, effect)

    def _minimum(self, reduced: Reduced, bounds: Bounds, joined: npt.NDArray[np.intp]) -> FloatArray:
        lower, upper, rows = self._lower, self._upper, self._no_rows
        if joined.size:
            lower = np.concatenate((lower, bounds.lower[joined]))
            upper = np.concatenate((upper, bounds.upper[joined]))
            rows = np.empty((0, upper.size))
        z, _, flag, _ = daqp.solve(reduced.hessian, reduced.gradient, rows, upper, lower)
        if flag < 1:
            raise UnsolvableError(f"DAQP ended with flag {flag}")
        minimum: FloatArray = z
        return minimum
