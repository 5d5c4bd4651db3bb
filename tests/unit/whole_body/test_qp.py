"""The reduced QP against the full one, solved as it stands, and what becomes of limits and of impossible problems."""

from dataclasses import dataclass

import daqp
import numpy as np
import pytest

from tests.unit.whole_body.conftest import RandomState, random_states
from valor.common.arrays import FloatArray
from valor.common.rotation import IDENTITY
from valor.control.motions import FEET
from valor.control.tuning_tables import Tuning
from valor.robot.description import RobotDescription
from valor.robot.model import Model
from valor.whole_body.command import QpStatus
from valor.whole_body.constraints import FootContacts, JointLimits, Limit, TorqueLimits, contact_points, sole_generators
from valor.whole_body.solver.elimination import FORCE_REGULARIZATION, UnsolvableError
from valor.whole_body.solver.qp import Bounds, ContactForceQp, Objective, Solution
from valor.whole_body.task_dynamics import TaskDynamics
from valor.whole_body.tasks import TASKS, WEIGHTS, motions, nominal_weights

EQUALITY = 5  # DAQP's sense


@dataclass
class Problem:
    dynamics: TaskDynamics
    objective: Objective
    contacts: FootContacts
    damping: FloatArray
    qp: ContactForceQp

    def unbounded(self) -> Bounds:
        n = len(self.damping)
        return Bounds(np.full(2 * n, -np.inf), np.full(2 * n, np.inf))

    def solve(self, bounds: Bounds) -> Solution:
        return self.qp.solve(self.objective, self.dynamics, self.contacts.forces, bounds)

    def solve_in_full(self, bounds: Bounds) -> tuple[FloatArray, FloatArray, float]:
        """v̇, ρ and the optimum of the problem as it stands: v̇ and ρ, six equalities, every limit a row."""
        d, forces, n = self.dynamics, self.contacts.forces, len(self.damping)
        nv, nr = n + 6, forces.shape[0]
        hessian = np.zeros((nv + nr, nv + nr))
        hessian[:nv, :nv] = self.objective.hessian
        hessian[nv:, nv:] = FORCE_REGULARIZATION * np.eye(nr)
        linear = np.concatenate((-self.objective.gradient, np.zeros(nr)))
        base = np.hstack((d.mass_matrix[:6], -forces[:, :6].T))
        torque = np.hstack((d.mass_matrix[6:], -forces[:, 6:].T))
        joints = np.hstack((np.zeros((n, 6)), np.eye(n), np.zeros((n, nr))))
        rho = np.hstack((np.zeros((nr, nv)), np.eye(nr)))
        offset = d.bias[6:] + self.damping * d.joint_velocity
        other, constant = np.zeros((0, nv + nr)), np.zeros(0)
        if bounds.others is not None:
            other, constant = np.pad(bounds.others.rows, ((0, 0), (0, nr))), bounds.others.offset
        rows = np.ascontiguousarray(np.vstack((base, torque, joints, other, rho)))
        constant = np.concatenate((offset, np.zeros(n), constant))
        lower = np.concatenate((-d.bias[:6], bounds.lower - constant, np.zeros(nr)))
        upper = np.concatenate((-d.bias[:6], bounds.upper - constant, np.full(nr, 1e30)))
        sense = np.zeros(len(lower), dtype=np.int32)
        sense[:6] = EQUALITY
        z, value, flag, _ = daqp.solve(
            hessian, linear, rows, np.minimum(upper, 1e30), np.maximum(lower, -1e30), sense, primal_tol=1e-9
        )
        assert flag == 1
        return z[:nv], z[nv:], float(value)

    def value(self, acceleration: FloatArray, rho: FloatArray) -> float:
        o = self.objective
        return float(
            0.5 * acceleration @ o.hessian @ acceleration
            - o.gradient @ acceleration
            + 0.5 * FORCE_REGULARIZATION * rho @ rho
        )


def problem(robot: RobotDescription, model: Model, state: RandomState, seed: int) -> Problem:
    rng = np.random.default_rng(seed)
    dynamics = state.evaluate(model)
    objective = Objective([task(robot) for task in TASKS], motions(model), dynamics.joints)
    objective.weigh(dict(zip(WEIGHTS, nominal_weights(robot.read(Tuning).whole_body), strict=True)), None)
    objective.update(
        dynamics, rng.normal(scale=2.0, size=dynamics.drift.size), rng.normal(scale=5.0, size=dynamics.joints.count)
    )
    contacts = FootContacts(robot, model.mj.nv)
    contacts.update(dynamics.jacobian[dynamics.rows[FEET]], dynamics.sole_rotation)
    damping = model.mj.dof_damping[6:].copy()
    limits = TorqueLimits(damping), JointLimits(robot, robot.read(Tuning).whole_body, dynamics.joints.places)
    qp = ContactForceQp(contacts.count, dynamics.joints.count, limits)
    return Problem(dynamics, objective, contacts, damping, qp)


@pytest.fixture(params=range(6))
def random_problem(request: pytest.FixtureRequest, robot: RobotDescription, model: Model) -> Problem:
    states = list(random_states(model, 6, seed=7))
    return problem(robot, model, states[request.param], request.param)


def assert_optimal(problem: Problem, bounds: Bounds, solution: Solution) -> None:
    """The solution keeps all constraints and is as good as the full QP's."""
    d, n = problem.dynamics, len(problem.damping)
    acceleration, rho, value = problem.solve_in_full(bounds)
    residual = d.mass_matrix[:6] @ solution.acceleration + d.bias[:6] - problem.contacts.forces[:, :6].T @ solution.rho
    np.testing.assert_allclose(residual, 0.0, atol=1e-6)
    assert (solution.rho >= -1e-8).all()
    values = np.concatenate((solution.torque, solution.acceleration[6:]))
    if (others := bounds.others) is not None:
        values = np.concatenate((values, others.rows @ solution.acceleration + others.offset))
    assert (values <= bounds.upper + 1e-4).all() and (values >= bounds.lower - 1e-4).all()
    assert problem.value(solution.acceleration, solution.rho) == pytest.approx(value, rel=1e-5, abs=1e-5)
    scale = np.abs(acceleration).max()
    np.testing.assert_allclose(solution.acceleration, acceleration, atol=1e-3 * scale)
    np.testing.assert_allclose(
        problem.contacts.forces.T @ solution.rho, problem.contacts.forces.T @ rho, atol=1e-3 * (1.0 + np.abs(rho).max())
    )
    assert len(solution.torque) == n


def test_without_limits_it_is_optimal_and_torque_is_that_of_inverse_dynamics(random_problem: Problem) -> None:
    bounds, d = random_problem.unbounded(), random_problem.dynamics
    solution = random_problem.solve(bounds)
    assert solution.status == QpStatus.OPTIMAL
    assert_optimal(random_problem, bounds, solution)
    forces = d.mass_matrix @ solution.acceleration + d.bias - random_problem.contacts.forces.T @ solution.rho
    np.testing.assert_allclose(forces[6:] + random_problem.damping * d.joint_velocity, solution.torque, atol=1e-8)
    np.testing.assert_allclose(forces[:6], 0.0, atol=1e-6)


@pytest.mark.parametrize(("torques", "accelerations"), [(5, 0), (4, 4)])
def test_with_limits_of_joints(random_problem: Problem, torques: int, accelerations: int) -> None:
    """Limits that cut off the largest torques and accelerations of the free solution."""
    n = len(random_problem.damping)
    free = random_problem.solve(random_problem.unbounded())
    bounds = random_problem.unbounded()
    for rows, values, cut in (
        (slice(0, n), free.torque, torques),
        (slice(n, None), free.acceleration[6:], accelerations),
    ):
        if cut:
            bounds.upper[rows] = np.sort(np.abs(values))[-cut]
            bounds.lower[rows] = -bounds.upper[rows]
    solution = random_problem.solve(bounds)
    assert solution.status == QpStatus.LIMITED and solution.limits.size >= 4
    assert_optimal(random_problem, bounds, solution)


@pytest.mark.parametrize("torque", [False, True])
def test_with_limits_of_what_several_joints_do(random_problem: Problem, torque: bool) -> None:
    """Two rows over all joints that the free solution breaks, alone and with limits of torque."""
    n, rng = len(random_problem.damping), np.random.default_rng(9)
    free = random_problem.solve(random_problem.unbounded())
    rows = np.hstack((np.zeros((2, 6)), rng.normal(size=(2, n))))
    offset = rng.normal(size=2)
    limit = Limit(rows, offset, np.zeros((2, 0)))
    lower, upper = np.full(2 * n + 2, -np.inf), np.full(2 * n + 2, np.inf)
    lower[2 * n :] = rows @ free.acceleration + offset + 3.0
    if torque:
        most = np.sort(np.abs(free.torque))[-3]
        lower[:n], upper[:n] = -most, most
    bounds = Bounds(lower, upper, limit)
    solution = random_problem.solve(bounds)
    assert solution.status == QpStatus.LIMITED and {2 * n, 2 * n + 1} <= set(solution.limits.tolist())
    assert_optimal(random_problem, bounds, solution)


def test_while_the_feet_push_everywhere_the_optimum_needs_no_solver(
    robot: RobotDescription, model: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At rest in the nominal posture, wanting to stay so: six equations give what the solver gives."""
    standing = problem(robot, model, next(iter(random_states(model, 1, seed=0))), 0)
    dynamics, n = standing.dynamics, len(standing.damping)
    dynamics.kinematics.update(IDENTITY, np.zeros(3), robot.nominal_posture[dynamics.joints.places], np.zeros(n))
    dynamics.evaluate()
    standing.objective.update(dynamics, np.zeros(dynamics.drift.size), np.zeros(n))
    standing.contacts.update(dynamics.jacobian[dynamics.rows[FEET]], dynamics.sole_rotation)
    acceleration, rho, _ = standing.solve_in_full(standing.unbounded())
    solver = daqp.solve

    def refuse(*arguments: object, **settings: object) -> None:
        raise AssertionError("the solver was asked")

    monkeypatch.setattr(daqp, "solve", refuse)
    solution = standing.solve(standing.unbounded())
    assert solution.status == QpStatus.OPTIMAL and (solution.rho > 0.0).all()
    np.testing.assert_allclose(solution.acceleration, acceleration, atol=1e-5)
    np.testing.assert_allclose(solution.rho, rho, atol=1e-4)
    # As soon as a generator is at its bound, the solver decides.
    standing.qp.limit_forces(np.full(standing.contacts.count, 0.9 * rho.max()))
    with pytest.raises(AssertionError, match="the solver was asked"):
        standing.solve(standing.unbounded())
    monkeypatch.setattr(daqp, "solve", solver)
    assert standing.solve(standing.unbounded()).rho.max() == pytest.approx(0.9 * rho.max())


def test_a_foot_that_shall_not_push_does_not(random_problem: Problem) -> None:
    random_problem.qp.limit_forces(random_problem.contacts.upper((0.0, 1.0), 700.0))
    solution = random_problem.solve(random_problem.unbounded())
    np.testing.assert_array_equal(solution.rho[:16], 0.0)
    left, right = random_problem.contacts.vertical_forces(solution.rho)
    assert left == pytest.approx(0.0, abs=1e-6)
    assert np.isfinite(right)


def test_a_solution_that_takes_too_long_is_given_up(random_problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    bounds, n = random_problem.unbounded(), len(random_problem.damping)
    most = np.sort(np.abs(random_problem.solve(bounds).torque))[-5]
    bounds.lower[:n], bounds.upper[:n] = -most, most
    assert random_problem.solve(bounds).status == QpStatus.LIMITED
    monkeypatch.setattr("valor.whole_body.solver.qp.ITERATIONS", 2)
    with pytest.raises(UnsolvableError, match="DAQP returned flag -4"):
        random_problem.solve(bounds)


def test_limits_that_cross_cannot_be_solved(random_problem: Problem) -> None:
    bounds = random_problem.unbounded()
    bounds.lower[3], bounds.upper[3] = 1.0, -1.0
    with pytest.raises(UnsolvableError, match="DAQP returned flag"):
        random_problem.solve(bounds)


@pytest.mark.parametrize(
    ("where", "value"), [*((name, np.nan) for name in ("gradient", "hessian", "bias", "forces")), ("hessian", -1e9)]
)
def test_no_number_or_no_minimum_cannot_be_solved(random_problem: Problem, where: str, value: float) -> None:
    p = random_problem
    arrays = {
        "gradient": p.objective.gradient, "hessian": p.objective.hessian[:, 2], "bias": p.dynamics.bias,
        "forces": p.contacts.forces[3],
    }  # fmt: skip
    arrays[where][2] = value
    with pytest.raises(UnsolvableError, match=r"not finite|not positive definite"):
        p.solve(p.unbounded())


def test_generators_span_friction_and_the_cop_rectangle(robot: RobotDescription) -> None:
    """Any non-negative sum is within the friction cone, pushes, and has its CoP within the contact points."""
    table, foot = robot.read(Tuning).whole_body, robot.tables.feet.left
    points = contact_points(foot, table.contact_inset)
    wrenches = sole_generators(points, table.friction)
    rng = np.random.default_rng(3)
    for _ in range(200):
        fx, fy, fz, tx, ty, _ = wrenches @ (rng.random(16) * (rng.random(16) < 0.3) * 100.0 + 1e-3)
        assert fz > 0.0 and np.hypot(fx, fy) <= table.friction * fz + 1e-9
        assert foot.heel + table.contact_inset - 1e-9 <= -ty / fz <= foot.toe - table.contact_inset + 1e-9
        assert abs(tx / fz) <= foot.half_width - table.contact_inset + 1e-9
