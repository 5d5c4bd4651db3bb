"""QP of a control period: objective, and solution for contact forces and accelerations by DAQP in the reduced form.

DAQP (Arnström, Bemporad & Axehill 2022) is a dual active-set method, called natively. Joint limits join the problem
only if the solution without them exceeds them, round by round until none is exceeded. A foot that must not push is not
in the problem. While no generator is at a bound, as nearly always when the robot stands, the unbounded optimum is the
optimum: it is tried first if it was valid in the last period, and needs no solver.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

import casadi as ca
import daqp
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel
from valor.control.kinematics import ModelJoints
from valor.control.motions import Motions
from valor.robot.limiter import Joints
from valor.whole_body.command import QpStatus
from valor.whole_body.constraints import UNBOUNDED, JointLimit, Limit, Solved
from valor.whole_body.solver.elimination import Elimination, Reduced, UnsolvableError
from valor.whole_body.task_dynamics import TaskDynamics
from valor.whole_body.tasks import GROUPS, Task

ROUNDS = 8  # Most rounds of limits joining the problem
ITERATIONS = 200  # Most iterations of DAQP, a few control periods; a step to keep balance rarely needs over 130
TOLERANCE = 1e-6  # Tolerance of a limit [N·m, rad/s²]
FROZEN_WEIGHT = 30.0  # of the posture of frozen joints
REGULARIZATION = 1e-4  # of every v̇ [1]: H is positive definite for any tasks


class Objective:
    """The weighted tasks as one quadratic in v̇.

    Task i has the desired acceleration aᵢ for Jᵢ·v̇ + dᵢ; the posture has those of single joints. The sum

        ½·Σ wᵢ·‖Jᵢ·v̇ + dᵢ − aᵢ‖² + ½·Σ pⱼ·(v̇ⱼ − bⱼ)²  =  ½·v̇ᵀ·H·v̇ − gᵀ·v̇ + const.

    has H = Σ wᵢ·JᵢᵀJᵢ + diag(p) and g = Σ wᵢ·Jᵢᵀ(aᵢ − dᵢ) + p∘b (Koolen et al. 2016, section 5).
    """

    def __init__(self, tasks: Sequence[Task], motions: Motions, joints: ModelJoints) -> None:
        """Create from tasks and their motions; call ``weigh`` before ``update``."""
        nv, rows = joints.count + 6, motions.count
        self._tasks = [(task, motions.rows[task.name]) for task in tasks]
        self._groups = {weight: joints.group(*groups) for weight, groups in GROUPS.items()}
        self._weight_column = np.zeros((rows, 1))
        self._weight = self._weight_column[:, 0]  # of each row
        self._posture_weight = np.zeros(joints.count)
        self._diagonal = np.full(nv, REGULARIZATION)
        self.hessian = np.zeros((nv, nv))  # (nv, nv) result of ``update``
        self.gradient = np.zeros(nv)  # (nv,) result of ``update``
        self._hessian_diagonal = np.einsum("ii->i", self.hessian)
        self._joint_gradient = self.gradient[6:]
        self._weighted = np.zeros((rows, nv))
        self._wanted = np.zeros(rows)

    def weigh(
        self, weights: Mapping[str, float], swing: tuple[int, float] | None, frozen: Joints | None = None
    ) -> None:
        """Set weights by name, the swing foot and its weight (None: neither), and a mask (nj,) of frozen joints."""
        for task, rows in self._tasks:
            task.weigh(weights[task.weight], swing, self._weight[rows])
        for weight, group in self._groups.items():
            self._posture_weight[group] = weights[weight]
        if frozen is not None:
            self._posture_weight[frozen] = FROZEN_WEIGHT
        self._diagonal[6:] = REGULARIZATION + self._posture_weight

    def update(self, dynamics: TaskDynamics, acceleration: FloatArray, posture: FloatArray) -> None:
        """Compute H and g at this state, from desired accelerations: (rows,) of motions, (nj,) of joints [rad/s²]."""
        weighted, wanted = self._weighted, self._wanted
        np.multiply(dynamics.jacobian, self._weight_column, out=weighted)
        np.subtract(acceleration, dynamics.drift, out=wanted)
        # Two matrices: for Aᵀ·A NumPy computes a triangle and copies it number by number.
        np.dot(dynamics.jacobian.T, weighted, self.hessian)
        self._hessian_diagonal += self._diagonal
        np.dot(wanted, weighted, self.gradient)
        self._joint_gradient += self._posture_weight * posture


@dataclass(slots=True)
class Bounds:
    """Limits in this period: of every joint, by kind; then ``others``."""

    lower: FloatArray  # (kinds·nj + k,)
    upper: FloatArray  # (kinds·nj + k,)
    others: Limit | None = None  # k more, on accelerations only


@dataclass(slots=True)
class Solution:
    """Optimum of a period."""

    acceleration: FloatArray  # (nv,) v̇
    rho: FloatArray  # (nρ,) forces along the generators [N]
    torque: FloatArray  # (nj,) [N·m]
    status: QpStatus
    limits: npt.NDArray[np.intp]  # indices of the bounds that joined the problem


class ContactForceQp:
    """Solves for contact forces and accelerations."""

    def __init__(self, generators: int, joints: int, limits: Sequence[JointLimit]) -> None:
        """Create a problem of nρ generators and nj joints without bounds; the first of the limits is of torques."""
        self._generators = generators
        self._joints, self._limits = joints, limits
        self._bounded = len(limits) * joints
        self._none = np.zeros(0, dtype=np.intp)
        n = self._joints
        self._elimination = Elimination(6 + n)
        self._given = np.zeros((5 + 2 * len(limits), n))
        self._values, self._excess = np.zeros(self._bounded), np.zeros(2)
        self._pushes_freely = True  # whether no generator was at a bound in the last period
        self._check = Kernel("limits", self._expressions, (self._given,), (self._values, self._excess))
        self.limit_forces(np.full(generators, UNBOUNDED))

    def limit_forces(self, upper: FloatArray) -> None:
        """Set (nρ,) upper bounds of generators [N]; 0 for those of a foot that must not push."""
        pushing = np.flatnonzero(upper)  # contiguous, as each foot's are
        self._pushing = slice(int(pushing[0]), int(pushing[-1]) + 1) if pushing.size else slice(None)
        self._upper = upper[self._pushing]
        self._lower = np.zeros(self._upper.size)
        self._upper_bounded = bool((self._upper < UNBOUNDED).any())
        self._no_rows = np.empty((0, self._upper.size))

    def solve(self, objective: Objective, dynamics: TaskDynamics, forces: FloatArray, bounds: Bounds) -> Solution:
        """Solve with this state's dynamics and (nρ, nv) ``forces`` of the generators; raises ``UnsolvableError``."""
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
            if not isfinite(squares):  # DAQP accepts NaN, and a maximum does not show it
                raise UnsolvableError("the solution is not finite")
            if others is not None:
                values = np.concatenate((values, others.rows @ acceleration + others.offset))
            status = QpStatus.LIMITED if joined.size else QpStatus.OPTIMAL
            if excess > TOLERANCE or others is not None:
                broken = (values > bounds.upper + TOLERANCE) | (values < bounds.lower - TOLERANCE)
                broken[joined] = False  # the rest is round-off
                if broken.any():
                    joined = np.concatenate((joined, np.flatnonzero(broken)))
                    continue
            return Solution(acceleration, self._all(pushes), values[:n], status, joined)
        raise UnsolvableError(f"joint limits still exceeded after {ROUNDS} rounds")

    def _expressions(self, given: Expression) -> Sequence[Expression]:
        """Values of all limits; (2,) largest excess of a bound, and sum of squares."""
        inertial, bias, velocity, contact, acceleration = (given[i, :].T for i in range(5))
        solved = Solved(inertial, bias, contact, velocity, acceleration)
        values = ca.vertcat(*(limit.value(solved) for limit in self._limits))
        kinds = len(self._limits)
        lower, upper = (ca.vec(given[i : i + kinds, :].T) for i in (5, 5 + kinds))
        excess = functools.reduce(ca.fmax, ca.vertsplit(ca.fmax(values - upper, lower - values)))
        return values, ca.vertcat(excess, ca.sumsqr(values))

    def _free(self, forces: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Forces along the pushing generators and accelerations, if no force bound is active."""
        found = self._elimination.unbounded(forces)
        return found if self._within(found[0]) else None

    def _within(self, pushes: FloatArray) -> bool:
        numbers = pushes.tolist()  # for thirty numbers Python is faster than NumPy
        return (
            min(numbers) > 0.0
            and isfinite(sum(numbers))
            and not (self._upper_bounded and bool((pushes >= self._upper).any()))
        )

    def _all(self, pushes: FloatArray) -> FloatArray:
        """(nρ,) forces of both feet."""
        rho = np.zeros(self._generators)
        rho[self._pushing] = pushes
        return rho

    def _limit(
        self, dynamics: TaskDynamics, forces: FloatArray, joined: npt.NDArray[np.intp], others: Limit | None
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
        z, _, flag, _ = daqp.solve(reduced.hessian, reduced.gradient, rows, upper, lower, iter_limit=ITERATIONS)
        if flag < 1:
            raise UnsolvableError(f"DAQP returned flag {flag}; expected 1 or more")
        minimum: FloatArray = z
        return minimum
