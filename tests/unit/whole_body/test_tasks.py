"""Every task of the table: its Jacobian and drift by finite differences, what it asks for by its equation."""

from collections.abc import Callable
from itertools import pairwise

import casadi as ca
import mujoco
import numpy as np
import pytest

from tests.unit.whole_body.conftest import RandomState, random_states
from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.kernel import Expression
from valor.control.kinematics import Kinematics
from valor.control.tuning_tables import Tuning
from valor.robot.description import RobotDescription
from valor.robot.model import Model
from valor.whole_body import tasks
from valor.whole_body.balance.reference import DcmLaw, Feet, Reference
from valor.whole_body.solver.qp import REGULARIZATION, Objective
from valor.whole_body.task_dynamics import TaskDynamics
from valor.whole_body.tasks import CATCH_UP, GROUPS, TASKS, WEIGHTS, Period, Posture, Task, motions, sole_rows, stance

STEP = 1e-6  # [s]
RNG = np.random.default_rng(5)
Measure = Callable[[Model, mujoco.MjData], list[FloatArray]]


def of_body(model: Model, data: mujoco.MjData, body: str) -> list[FloatArray]:
    return [data.xmat[model.body(body)].reshape(3, 3).copy()]


def of_soles(model: Model, data: mujoco.MjData) -> list[FloatArray]:
    feet = model.robot.tables.feet
    sites = [model.site(foot.sole) for foot in (feet.left, feet.right)]
    return [part for site in sites for part in (data.site_xpos[site].copy(), data.site_xmat[site].reshape(3, 3).copy())]


PLACES: dict[str, Measure] = {
    "com": lambda model, data: [data.subtree_com[model.body(model.robot.tables.base)].copy()],
    "chest": lambda model, data: of_body(model, data, model.robot.tables.chest),
    "pelvis": lambda model, data: of_body(model, data, model.robot.tables.base),
    "feet": of_soles,
}
"""What a task's motion is of, as MuJoCo has it: places (3,) and rotations (3, 3)."""


def moved(model: Model, state: RandomState, time: float) -> mujoco.MjData:
    """MuJoCo's data so much later at the same velocities, with every quantity."""
    data = mujoco.MjData(model.mj)
    data.qpos[:], data.qvel[:] = state.qpos, state.qvel
    mujoco.mj_integratePos(model.mj, data.qpos, state.qvel, time)
    mujoco.mj_forward(model.mj, data)
    mujoco.mj_subtreeVel(model.mj, data)
    return data


def rate(after: FloatArray, before: FloatArray, time: float) -> FloatArray:
    """(3,) of a place, or the angular velocity of a rotation."""
    return (after - before if after.ndim == 1 else rotation.rotation_vector(after @ before.T)) / time


@pytest.fixture(params=range(4))
def state(request: pytest.FixtureRequest, model: Model) -> RandomState:
    state: RandomState = list(random_states(model, 4, seed=21))[request.param]
    return state


@pytest.mark.parametrize("task", [task for task in TASKS if task.name in PLACES], ids=lambda task: task.name)
def test_a_jacobian_gives_the_velocity_of_what_it_is_of(task: type[Task], model: Model, state: RandomState) -> None:
    """J·v against the differences of places and rotations along the motion itself."""
    dynamics, measure = state.evaluate(model), PLACES[task.name]
    pairs = zip(measure(model, moved(model, state, STEP)), measure(model, moved(model, state, -STEP)), strict=True)
    numeric = np.concatenate([rate(after, before, 2.0 * STEP) for after, before in pairs])
    np.testing.assert_allclose(dynamics.jacobian[dynamics.rows[task.name]] @ state.qvel, numeric, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.name)
def test_a_drift_is_the_velocitys_change_at_constant_v(task: type[Task], model: Model, state: RandomState) -> None:
    step, rows = 1e-5, motions(model).rows[task.name]

    def velocity(time: float) -> FloatArray:
        later = RandomState(moved(model, state, time).qpos, state.qvel, state.data).evaluate(model)
        result: FloatArray = later.jacobian[rows] @ state.qvel
        return result

    numeric = (velocity(step) - velocity(-step)) / (2.0 * step)
    np.testing.assert_allclose(state.evaluate(model).drift[rows], numeric, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.name)
def test_a_velocity_is_that_of_the_jacobian(task: type[Task], model: Model, state: RandomState) -> None:
    dynamics, of_all = state.evaluate(model), motions(model)
    rows = of_all.rows[task.name]
    whole = dynamics.task_velocity[rows] + of_all.carried[rows] @ state.qvel[:3]
    np.testing.assert_allclose(whole, dynamics.jacobian[rows] @ state.qvel, atol=1e-10)


def test_rows_and_weights_have_the_order_of_the_interface(robot: RobotDescription, model: Model) -> None:
    of_all, table = motions(model), robot.read(Tuning).whole_body
    assert list(of_all.rows) == [task.name for task in TASKS]
    ends = [0, *(rows.stop for rows in of_all.rows.values())]
    assert [(rows.start, rows.stop) for rows in of_all.rows.values()] == list(pairwise(ends))
    assert ends[-1] == of_all.count == len(of_all.carried)
    assert WEIGHTS[:4] == ("com", "angular_momentum", "orientation", "foot")
    assert WEIGHTS[-3:] == ("arm_posture", "waist_posture", "leg_posture")
    assert tasks.nominal_weights(table) == [getattr(table, f"{name}_weight") for name in WEIGHTS]


# --- what they ask for ------------------------------------------------------------------------------------------------
def period(
    robot: RobotDescription, dynamics: TaskDynamics, *, steps: bool, swinging: int | None
) -> tuple[Period, FloatArray]:
    """A period with random references; and (24,) where the swinging foot shall be."""
    turned = [ca.DM(rotation.from_rotation_vector(RNG.normal(scale=0.3, size=3))) for _ in range(2)]
    vectors = [ca.DM(RNG.normal(scale=0.1, size=3)) for _ in range(6)]
    reference = Reference(*vectors[:5], ca.DM(RNG.normal(size=3)), ca.DM(0.5), *turned)  # type: ignore[call-arg]
    feet = Feet(ca.DM(dynamics.kinematics.sole_position), ca.DM(dynamics.sole_rotation.reshape(6, 3)))
    law = DcmLaw(3.5, robot.read(Tuning).whole_body.dcm_gain, 1.0, 0.1, 0.01)
    swing = np.concatenate((RNG.normal(size=3), np.eye(3).ravel(), RNG.normal(size=12)))
    kept = stance(feet) + ca.DM((0.01, -0.02, 0.03))
    flags = ca.DM([swinging == 0, swinging == 1])
    return Period(reference, law, vectors[5], vectors[4], feet, kept, ca.DM(steps), flags, ca.DM(swing)), swing


def asked(
    task: type[Task], robot: RobotDescription, model: Model, now: Period, dynamics: TaskDynamics
) -> tuple[FloatArray, FloatArray]:
    """What a task asks for, and the velocity that it was given."""
    of_all = motions(model)
    velocity = dynamics.jacobian[of_all.rows[task.name]] @ dynamics.velocity
    pose = dynamics.poses[of_all.poses[task.name]]
    wanted: Expression = task(robot).acceleration(now, ca.SX(ca.DM(velocity)), ca.SX(ca.DM(pose)))
    return np.array(ca.evalf(wanted))[:, 0], velocity


def named(name: str) -> type[Task]:
    return next(task for task in TASKS if task.name == name)


def test_the_com_is_led_from_the_repellent_point_and_angular_momentum_is_damped(
    robot: RobotDescription, model: Model, state: RandomState
) -> None:
    now, _ = period(robot, dynamics := state.evaluate(model), steps=False, swinging=None)
    com, _ = asked(named("com"), robot, model, now, dynamics)
    np.testing.assert_allclose(com, 3.5**2 * np.array(now.com - now.repellent_point)[:, 0], rtol=1e-12)
    damped, momentum = asked(named("angular_momentum"), robot, model, now, dynamics)
    np.testing.assert_allclose(damped, -robot.read(Tuning).whole_body.angular_momentum_gain * momentum)


@pytest.mark.parametrize("name", ["chest", "pelvis"])
def test_orientations_follow_the_reference(
    robot: RobotDescription, model: Model, state: RandomState, name: str
) -> None:
    table = robot.read(Tuning).whole_body
    now, _ = period(robot, dynamics := state.evaluate(model), steps=False, swinging=None)
    wanted, velocity = asked(named(name), robot, model, now, dynamics)
    actual = of_body(model, state.data, getattr(model.robot.tables, "base" if name == "pelvis" else name))[0]
    error = np.array(rotation.error(np.array(getattr(now.reference, name)), actual))
    turning = np.array(now.reference.turning)[:, 0]
    expected = table.orientation_stiffness * error + table.orientation_damping * (turning - velocity)
    np.testing.assert_allclose(wanted, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("swinging", [None, 0, 1])
def test_feet_stay_or_follow_their_path(
    robot: RobotDescription, model: Model, state: RandomState, swinging: int | None
) -> None:
    walking, damping = robot.tables.walking, robot.read(Tuning).whole_body.foot_damping
    now, swing = period(robot, dynamics := state.evaluate(model), steps=True, swinging=swinging)
    wanted, velocity = asked(named("feet"), robot, model, now, dynamics)
    for foot in range(2):
        rows = sole_rows(foot)
        expected = -damping * velocity[rows]
        if foot == swinging:
            turned = rotation.error(np.eye(3), dynamics.sole_rotation[foot])
            away = np.concatenate((swing[:3] - dynamics.kinematics.sole_position[foot], turned))
            expected = (
                swing[18:] + walking.foot_stiffness * away + walking.foot_damping * (swing[12:18] - velocity[rows])
            )
        np.testing.assert_allclose(wanted[rows], expected, rtol=1e-9, atol=1e-9)


def test_posture_is_followed_no_faster_than_allowed(robot: RobotDescription, model: Model) -> None:
    """Near its reference a joint is led by k_p and k_d; far from it, it makes up for half of its velocity limit."""
    table, joints = robot.read(Tuning).whole_body, Kinematics(model).joints
    legs = joints.group("left_leg", "right_leg").tolist()
    posture = Posture(robot, joints.places, legs)
    n, arm = joints.count, int(joints.group("right_arm")[0])
    requested, position, velocity = np.zeros((3, n)), np.zeros(n), RNG.normal(size=n)
    requested[1], requested[2] = 0.2, 0.3
    requested[0], requested[0, arm] = 0.001, 10.0
    wanted = np.array(
        ca.DM(posture.acceleration(ca.DM(requested), ca.DM.zeros(len(legs)), ca.DM(position), ca.DM(velocity)))
    )[:, 0]
    stiffness, damping = table.posture_stiffness, table.posture_damping
    expected = 0.3 + stiffness * 0.001 + damping * (0.2 - velocity)
    expected[legs] = -damping * velocity[legs]
    most = CATCH_UP * robot.velocity_limit[joints.places][arm]
    expected[arm] = 0.3 + damping * (0.2 + most - velocity[arm])
    np.testing.assert_allclose(wanted, expected, rtol=1e-9)


# --- weights ----------------------------------------------------------------------------------------------------------
def test_the_objective_weighs_each_task_by_its_own_weight(robot: RobotDescription, model: Model) -> None:
    """H is the sum of w·JᵀJ; the swinging foot has a weight of its own."""
    dynamics = next(iter(random_states(model, 1, seed=3))).evaluate(model)
    objective = Objective([task(robot) for task in TASKS], motions(model), dynamics.joints)
    weights = {name: 1.0 + i for i, name in enumerate(WEIGHTS)}
    objective.weigh(weights, (1, robot.tables.walking.foot_weight))
    objective.update(dynamics, np.zeros(dynamics.drift.size), np.zeros(dynamics.joints.count))
    expected = REGULARIZATION * np.eye(dynamics.joints.count + 6)
    for task in TASKS:
        jacobian = dynamics.jacobian[dynamics.rows[task.name]]
        weight = np.full(len(jacobian), weights[task.weight])
        if task.name == "feet":
            weight[sole_rows(1)] = robot.tables.walking.foot_weight
        expected += jacobian.T @ np.diag(weight) @ jacobian
    for name, groups in GROUPS.items():
        places = 6 + dynamics.joints.group(*groups)
        expected[places, places] += weights[name]
    np.testing.assert_allclose(objective.hessian, expected, rtol=1e-9, atol=1e-9)
