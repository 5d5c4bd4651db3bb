"""What a hand carries and what it presses on, and what the arm's servos receive of it."""

import copy

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.still_robot import MODEL, ROBOT, Robot
from harness.waiting import some
from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.motion_manager.hands.hand_goals import seen_from_pelvis

LEFT, RIGHT = slice(0, 7), slice(7, 14)
SMALL = st.floats(-1.0, 1.0)


@pytest.fixture(scope="module")
def standing() -> Robot:
    return Robot().stand()


def in_hand(force: FloatArray) -> FloatArray:
    """(6,) what the right wrist feels of a force (3,) in world, the robot as it stands [N]."""
    data = mujoco.MjData(MODEL.mj)
    data.qpos[:] = MODEL.nominal_qpos()
    mujoco.mj_kinematics(MODEL.mj, data)
    hand = some(ROBOT.tables.hands.right)
    turn = data.site_xmat[MODEL.site(hand.site)].reshape(3, 3)
    return np.concatenate((turn.T @ force, np.zeros(3)))


def lifted_by(arm: str) -> FloatArray:
    """(m,) how far each joint lifts the right hand [m/rad]."""
    data, eps = mujoco.MjData(MODEL.mj), 1e-6
    hand = some(ROBOT.tables.hands.right)
    heights = []
    for joint in (None, *ROBOT.tables.group(arm)):
        data.qpos[:] = MODEL.nominal_qpos()
        if joint is not None:
            data.qpos[MODEL.mj.joint(joint).qposadr[0]] += eps
        mujoco.mj_kinematics(MODEL.mj, data)
        heights.append(data.site_xpos[MODEL.site(hand.site)][2])
    lifted: FloatArray = (np.array(heights[1:]) - heights[0]) / eps
    return lifted


def test_a_load_is_held_by_the_arm_that_carries_it_and_forgotten_when_it_is_put_down(standing: Robot) -> None:
    parts = standing.manager.components
    standing.run(2.0, right_hand_wrench=in_hand(np.array((0.0, 0.0, -30.0))))
    assert parts.hand_loads.weights == pytest.approx([0.0, 30.0], abs=0.3) and not parts.servos.load[LEFT].any()
    np.testing.assert_allclose(parts.servos.load[RIGHT], 30.0 * lifted_by("right_arm"), atol=0.3)
    standing.run(2.0)
    assert parts.hand_loads.weights == [0.0, 0.0] and not parts.servos.load.any()


def test_a_hand_that_lifts_in_vain_is_resisted_and_lifts_no_more(standing: Robot) -> None:
    loads = standing.manager.components.hand_loads
    standing.run(2.0, right_hand_wrench=in_hand(np.array((0.0, 0.0, -55.0))))
    assert loads.weights[1] == pytest.approx(55.0, rel=0.01) and not loads.resisted[1]
    standing.run(0.3, right_hand_wrench=in_hand(np.array((0.0, 0.0, -100.0))))
    assert loads.resisted[1] == pytest.approx(100.0, abs=0.1) and loads.weights == [0.0, 0.0]
    standing.run(2.0)


@pytest.mark.parametrize("force", [(-30.0, 0.0, 0.0), (0.0, 30.0, -10.0), (0.0, 0.0, 30.0)])
def test_a_hand_that_presses_on_something_presses_no_more(standing: Robot, force: tuple[float, float, float]) -> None:
    """Both arms are off by the same: the one that is free goes on to make up for it, the other does not."""
    servos = standing.manager.components.servos
    off = ROBOT.nominal_posture.copy()
    off[servos.joints] -= 0.01
    wrench = in_hand(np.array(force))
    standing.run(0.1, right_hand_wrench=wrench, joint_position=off)
    before = servos.integral.copy()
    standing.run(0.1, right_hand_wrench=wrench, joint_position=off)
    np.testing.assert_array_equal(servos.integral[RIGHT], before[RIGHT])
    assert (servos.integral[LEFT] > before[LEFT]).all()
    assert not standing.manager.components.hand_loads.weights[1]
    standing.run(0.1)
    assert not servos.pressing.any()


def test_what_pushes_a_hand_down_that_presses_in_vain_is_not_held_as_a_load(standing: Robot) -> None:
    """A spoke above it feels like a weight; held, it would jam the hand for good."""
    parts = standing.manager.components
    standing.run(2.0, right_hand_wrench=in_hand(np.array((0.0, 0.0, -30.0))))
    assert parts.hand_loads.weights[1] > 20.0
    standing.run(0.3, right_hand_wrench=in_hand(np.array((-100.0, 0.0, -30.0))))
    assert parts.hand_loads.resisted[1] > 60.0 and parts.hand_loads.weights == [0.0, 0.0]
    assert not parts.servos.load.any()
    standing.run(0.5)


@given(numbers=st.tuples(*[SMALL] * 9))
def test_a_goal_in_odom_moves_in_pelvis_as_the_pelvis_does(standing: Robot, numbers: tuple[float, ...]) -> None:
    """Its twist is what a moment changes of its pose."""
    place, velocity, turning = np.array(numbers).reshape(3, 3)
    state, dt = copy.copy(standing.manager.components.state), 1e-6
    assert state is not None
    state.pelvis_linear_velocity_in_odom, state.pelvis_angular_velocity_in_pelvis = velocity, turning
    before, turn, twist = seen_from_pelvis(place, np.eye(3), state)
    state.pelvis_position_in_odom = state.pelvis_position_in_odom + dt * velocity
    step = np.empty(9)
    quaternion = np.array((1.0, 0.0, 0.0, 0.0))
    mujoco.mju_quatIntegrate(quaternion, turning, dt)
    mujoco.mju_quat2Mat(step, quaternion)
    state.pelvis_rotation_in_odom = state.pelvis_rotation_in_odom @ step.reshape(3, 3)
    after, turned, _ = seen_from_pelvis(place, np.eye(3), state)
    np.testing.assert_allclose((after - before) / dt, twist[:3], atol=1e-4)
    np.testing.assert_allclose(rotation.rotation_vector(turned @ turn.T) / dt, twist[3:], atol=1e-4)
