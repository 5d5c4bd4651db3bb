"""Bounds on accelerations keep joints off their stops and within their speed."""

from typing import Any

import casadi as ca
import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.closed_loop import ClosedLoop, load_robot
from harness.examples import examples
from tests.unit.whole_body.conftest import random_states
from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.common.kernel import Kernel
from valor.control.kinematics import Kinematics
from valor.control.steps import Step
from valor.control.tuning_tables import Tuning
from valor.robot.footsteps import LEFT
from valor.robot.model import Model, controller_model
from valor.whole_body.constraints import JointLimit, JointLimits, SelfCollision, Solved, TorqueLimits
from valor.whole_body.task_dynamics import TaskDynamics
from valor.whole_body.tasks import motions
from valor.whole_body.walking.footsteps import StepQueue, level_pose

ROBOT = load_robot()
LIMITS = JointLimits(ROBOT, ROBOT.read(Tuning).whole_body, slice(0, 27))
POSITION, VELOCITY, LOWEST, HIGHEST = np.zeros((4, 27))
KERNEL = Kernel("limits", LIMITS.acceleration, (POSITION, VELOCITY), (LOWEST, HIGHEST))
LOWER, UPPER = ROBOT.lower[:27], ROBOT.upper[:27]
SPEED = ROBOT.velocity_limit[:27]
DT = ROBOT.control_period


def bounds(position: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(27,) lowest and highest accelerations."""
    POSITION[:], VELOCITY[:] = position, velocity
    KERNEL()
    return LOWEST.copy(), HIGHEST.copy()


@given(st.floats(-0.5, 1.5), st.floats(-3.0, 3.0))
def test_bounds_never_cross(share: float, speed: float) -> None:
    """Also beyond the stops and above the speed limit."""
    position = LOWER + share * (UPPER - LOWER)
    lower, upper = bounds(position, speed * SPEED)
    assert (lower <= upper).all()


@examples(15)
@given(st.floats(0.0, 1.0), st.sampled_from((-1.0, 1.0)))
def test_a_joint_driven_as_hard_as_allowed_stays_within_its_limits(share: float, direction: float) -> None:
    position, velocity = LOWER + share * (UPPER - LOWER), np.zeros(27)
    for _ in range(1000):
        lower, upper = bounds(position, velocity)
        velocity = velocity + np.clip(direction * 1e3, lower, upper) * DT
        position = position + velocity * DT
        assert (np.abs(velocity) <= SPEED * 1.001).all()
    assert (position >= LOWER - 1e-3).all() and (position <= UPPER + 1e-3).all()


def test_far_from_stops_nothing_but_the_speed_limit_binds() -> None:
    _, upper = bounds(0.5 * (LOWER + UPPER), np.zeros(27))
    assert (upper > 5.0).all()


@pytest.mark.parametrize("kind", ["torque", "acceleration"])
def test_rows_are_the_derivatives_of_values(model: Model, kind: str) -> None:
    """y = c·v̇ + e − s·ρ by differences in v̇ and ρ, and torques as MuJoCo's inverse dynamics has them."""
    state = next(iter(random_states(model, 1, seed=17)))
    dynamics, n = state.evaluate(model), model.mj.nv - 6
    damping = model.mj.dof_damping[6:].copy()
    limits: JointLimit = TorqueLimits(damping) if kind == "torque" else LIMITS
    rng = np.random.default_rng(4)
    acceleration, pushes, forces = rng.normal(size=n + 6), rng.random(32), rng.normal(size=(32, n + 6))

    def value(acceleration: np.ndarray, pushes: np.ndarray) -> np.ndarray:
        inertial = (dynamics.mass_matrix @ acceleration)[6:]
        columns = inertial, dynamics.bias[6:], (pushes @ forces)[6:], dynamics.joint_velocity, acceleration[6:]
        return np.array(ca.DM(limits.value(Solved(*map(ca.DM, columns)))))[:, 0]

    joints = np.array((0, 3, n - 1))
    rows, offset, effect = limits.rows(dynamics, forces, joints)
    now = value(acceleration, pushes)[joints]
    np.testing.assert_allclose(rows @ acceleration + offset - effect @ pushes, now, rtol=1e-9, atol=1e-9)
    for column, place in ((rows, 0), (-effect, 1)):
        for i in range(column.shape[1]):
            step = [np.zeros(n + 6), np.zeros(32)]
            step[place][i] = 1.0
            moved = value(acceleration + step[0], pushes + step[1])[joints]
            np.testing.assert_allclose(moved - now, column[:, i], atol=1e-9)
    if kind == "torque":
        data = state.data
        data.qacc[:] = acceleration
        inverse = np.zeros(n + 6)
        mujoco.mj_rne(model.mj, data, 1, inverse)
        inverse += model.mj.dof_armature * acceleration
        expected = inverse[6:] + damping * dynamics.joint_velocity - (pushes @ forces)[6:]
        np.testing.assert_allclose(value(acceleration, pushes), expected, atol=1e-8)


# Parts of the robot keep apart: the rows against differences of distances, and what they do in closed loop.
NOBODY: dict[str, Any] = {"self_collision": {"pairs": []}}
ARM = {"l_shoulder_roll": -0.3, "l_shoulder_yaw": -1.5, "l_elbow_pitch": 0.3, "l_shoulder_pitch": 0.2}  # into the chest
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


def evaluate(model: Model, position: FloatArray, velocity: FloatArray) -> TaskDynamics:
    """At a posture, upright and without turning."""
    kinematics = Kinematics(model)
    dynamics = TaskDynamics(kinematics, motions(model))
    kinematics.update(rotation.quaternion(UPRIGHT), np.zeros(3), position, velocity)
    dynamics.evaluate()
    return dynamics


@pytest.mark.parametrize("pair", [("l_thigh", "r_thigh"), ("l_thigh", "r_shin"), ("l_shin", "r_shin")])
def test_a_row_is_how_the_distance_changes(pair: tuple[str, str]) -> None:
    """Between capsules: ḋ is row·v, and from it comes the barrier."""
    robot = load_robot(self_collision={"pairs": [pair], "near": 0.45, "distance": 0.0})
    model = controller_model(robot)
    collision = SelfCollision(model)
    one, other = model.shape(pair[0]), model.shape(pair[1])
    rng, step, segment = np.random.default_rng(4), 1e-4, np.zeros(6)
    posture = robot.nominal_posture[Kinematics(model).joints.places]
    for k in range(8):
        position = posture + rng.uniform(-0.15, 0.15, posture.size)
        velocity = rng.uniform(-0.5, 0.5, posture.size)
        distances = [
            evaluate(model, position + i * step * velocity, velocity).nearest(one, other, 1.0, segment)
            for i in (-1, 0, 1)
        ]
        limit = collision.update(evaluate(model, position, velocity), velocity, k)
        assert limit is not None
        assert limit.rows[0, :6] == pytest.approx(0.0, abs=1e-6)  # the pelvis carries both
        rate = (distances[2] - distances[0]) / (2.0 * step)
        assert float(limit.rows[0, 6:] @ velocity) == pytest.approx(rate, abs=2e-4)
        table = robot.tables.self_collision
        allowed = min(0.3, -table.approach * distances[1])
        assert collision.lower[0] == pytest.approx(table.response * (allowed - rate), abs=0.05)


def reach_into_the_chest(loop: ClosedLoop) -> float:
    """Lead the left arm there; the least distance of forearm and hand from the chest in the plant [m]."""
    loop.settle(0.3)
    loop.run(0.3)
    model, segment, least = loop.plant.model, np.zeros(6), np.inf
    shapes, chest = (model.shape("l_hand"), model.shape("l_forearm")), model.shape("chest")
    start = loop.reference.position.copy()
    goal = start.copy()
    for joint, angle in ARM.items():
        goal[loop.robot.index[joint]] = angle
    began = loop.time

    def lead(loop: ClosedLoop) -> None:
        nonlocal least
        share = min(1.0, loop.time - began)
        loop.reference.position[:] = start + share * (goal - start)
        loop.reference.velocity[:] = (goal - start) * (share < 1.0)
        distances = [mujoco.mj_geomDistance(model.mj, loop.plant.data, s, chest, 1.0, segment) for s in shapes]
        least = min(least, *distances)

    loop.run(1.3, lead)
    return least


def test_a_hand_led_into_the_chest_stops_before_it() -> None:
    loop = ClosedLoop(load_robot(), "hardware", 1)
    kept = loop.robot.tables.self_collision.distance
    assert reach_into_the_chest(loop) > 0.5 * kept and loop.controller.collision.rows > 0
    assert loop.fall is None and loop.command.qp_failures == 0


def test_without_a_table_it_touches() -> None:
    assert reach_into_the_chest(ClosedLoop(load_robot(**NOBODY), "hardware", 1)) < 0.0


@pytest.mark.parametrize("apart", [True, False])
def test_a_foot_sent_onto_the_other_comes_down_beside_it(apart: bool) -> None:
    loop = ClosedLoop(load_robot() if apart else load_robot(**NOBODY), "hardware", 0)
    loop.settle(0.3)
    loop.run(0.6)
    x, y, z = (loop.state.sole_positions_in_odom[1] + (0.0, 0.08, 0.0)).tolist()
    queue = loop.request.steps = StepQueue()
    queue.begin([Step(0, LEFT, level_pose(x, y, z, 0.0), 0.05, 0.8, 0.6)])
    model, segment, least = loop.plant.model, np.zeros(6), np.inf
    left, right = model.shape("l_foot"), model.shape("r_foot")
    until = loop.time + 2.4
    while loop.time < until:
        loop.step()
        least = min(least, mujoco.mj_geomDistance(model.mj, loop.plant.data, left, right, 1.0, segment))
    if apart:
        assert least > 0.005
        assert loop.command.qp_failures == 0 and loop.fall is None
    else:
        assert least < 0.0


def test_a_pair_that_the_model_does_not_have_is_reported() -> None:
    with pytest.raises(ConfigurationError, match=r"self_collision\.pairs\.0: got 'l_tail'; expected a body of"):
        controller_model(load_robot(self_collision={"pairs": [("l_tail", "chest")]}))
