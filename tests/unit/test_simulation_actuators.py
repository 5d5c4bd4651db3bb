"""The law of each joint mode, and what an actuator profile makes of it."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from harness.examples import examples
from harness.places import ROBOTS
from valor.common.arrays import FloatArray
from valor.common.messages import JointMode, Motor
from valor.robot.description import RobotDescription
from valor.robot.tables import ActuatorProfile, Gear
from valor.simulation.actuators import Actuators, Gears

ROBOT = RobotDescription.load(ROBOTS / "escher")
N = len(ROBOT.joints)
STEP = 0.001
IDEAL = ActuatorProfile()
REST = np.zeros(N)


def motor(mode: JointMode | npt.NDArray[np.uint8], sequence: int = 1, **fields: float | FloatArray) -> Motor:
    """A Motor; scalars stand for all joints, fields not named are 0."""
    names = ("position", "velocity", "effort", "stiffness", "damping")
    vectors = {name: np.broadcast_to(np.asarray(fields.get(name, 0.0), float), N).copy() for name in names}
    modes = np.broadcast_to(np.asarray(mode, np.uint8), N).copy()
    return Motor(time=0, sequence=sequence, proprioceptor_sequence=1, mode=modes, behavior="stand", writer=1, **vectors)


def effort(command: Motor, position: FloatArray, velocity: FloatArray, profile: ActuatorProfile = IDEAL) -> FloatArray:
    actuators = Actuators(ROBOT, profile, STEP)
    actuators.obey(command)
    return actuators.update(position, velocity).copy()


def test_each_joint_uses_the_commanded_gains_by_its_own_mode() -> None:
    modes = np.zeros(N, dtype=np.uint8)
    modes[1:3] = JointMode.IMPEDANCE, JointMode.FORCE
    command = motor(modes, position=0.02, velocity=0.1, effort=0.5, stiffness=10.0, damping=2.0)
    result = effort(command, REST + 0.01, REST + 0.15)
    np.testing.assert_allclose(result[1:3], (0.5 + 10 * 0.01 - 2 * 0.05, 0.5 - 2 * 0.15), atol=1e-12)
    assert np.count_nonzero(result) == 2


def test_position_is_the_joints_own_servo_with_feed_forward() -> None:
    command = motor(JointMode.POSITION, position=0.002, velocity=0.01, effort=0.5, stiffness=1e6, damping=1e6)
    knee = ROBOT.index["l_knee_pitch"]
    servo = ROBOT.tables.joints["l_knee_pitch"].servo
    result = effort(command, REST + 0.001, REST + 0.02)
    assert result[knee] == pytest.approx(0.5 + servo.stiffness * 0.001 - servo.damping * 0.01)


def test_position_set_points_are_clamped_to_the_joints_limits() -> None:
    knee = ROBOT.index["l_knee_pitch"]
    at_limit = REST.copy()
    at_limit[knee] = ROBOT.lower[knee]
    command = motor(JointMode.IMPEDANCE, position=-1.0, stiffness=10.0)
    assert effort(command, at_limit, REST)[knee] == 0.0


FINITE = st.floats(-1e6, 1e6)


@given(
    arrays(np.uint8, N, elements=st.integers(0, 3)),
    *(arrays(np.float64, N, elements=FINITE) for _ in range(3)),
    *(arrays(np.float64, N, elements=st.floats(0, 1e6)) for _ in range(2)),
    *(arrays(np.float64, N, elements=st.floats(-50, 50)) for _ in range(2)),
    st.sampled_from([IDEAL, ROBOT.tables.actuators["hardware"], ActuatorProfile(backlash=0.01)]),
)
@examples(60)
def test_effort_is_always_within_limits(
    modes: npt.NDArray[np.uint8],
    position: FloatArray,
    velocity: FloatArray,
    feed_forward: FloatArray,
    stiffness: FloatArray,
    damping: FloatArray,
    q: FloatArray,
    v: FloatArray,
    profile: ActuatorProfile,
) -> None:
    actuators = Actuators(ROBOT, profile, STEP)
    actuators.obey(
        motor(modes, position=position, velocity=velocity, effort=feed_forward, stiffness=stiffness,
              damping=damping)
    )  # fmt: skip
    for _ in range(8):
        result = actuators.update(q, v)
        assert (np.abs(result) <= ROBOT.effort_limit * (1 + 1e-12)).all()
    if profile is IDEAL:
        fast = np.abs(v) > ROBOT.velocity_limit
        assert (result[fast] * v[fast] <= 0).all()


def test_no_effort_speeds_a_joint_up_beyond_its_velocity_limit() -> None:
    command = motor(JointMode.FORCE, effort=1.0)
    fast = ROBOT.velocity_limit * 1.01
    np.testing.assert_array_equal(effort(command, REST, fast), 0.0)
    np.testing.assert_array_equal(effort(command, REST, -fast), 1.0)  # braking is allowed
    np.testing.assert_array_equal(effort(command, REST, ROBOT.velocity_limit * 0.99), 1.0)


def test_commands_act_after_the_delay_in_order() -> None:
    actuators = Actuators(ROBOT, ActuatorProfile(delay=0.004), STEP)
    seen = []
    for sequence in range(1, 9):
        actuators.obey(motor(JointMode.FORCE, sequence=sequence, effort=float(sequence) / 10))
        seen.append(actuators.update(REST, REST)[0])
        assert actuators.motor_sequence == max(0, sequence - 4)
    np.testing.assert_allclose(seen, [0, 0, 0, 0, 0.1, 0.2, 0.3, 0.4])


def test_torque_lags_by_its_time_constant() -> None:
    actuators = Actuators(ROBOT, ActuatorProfile(torque_lag=0.005), STEP)
    actuators.obey(motor(JointMode.FORCE, effort=1.0))
    response = [actuators.update(REST, REST)[0] for _ in range(50)]
    for milliseconds in (1, 5, 20):
        assert response[milliseconds - 1] == pytest.approx(1 - math.exp(-milliseconds / 5))
    assert response[-1] == pytest.approx(1.0, abs=1e-4)


def test_backlash_is_a_dead_zone_of_its_full_width() -> None:
    profile = ActuatorProfile(backlash=0.002)
    command = motor(JointMode.IMPEDANCE, position=0.0, stiffness=10.0)
    shoulder = ROBOT.index["l_shoulder_pitch"]
    for error, expected in ((0.0009, 0.0), (-0.0009, 0.0), (0.003, 0.02), (-0.003, -0.02)):
        assert effort(command, REST - error, REST, profile)[shoulder] == pytest.approx(expected)


def test_a_joints_gear_goes_before_its_groups_and_that_before_the_profile() -> None:
    special = {"right_arm": Gear(backlash=0.04, feed_forward=False), "r_wrist_yaw": Gear(friction=6.0, strength=0.5)}
    gears = Gears.of(ROBOT, ActuatorProfile(friction=2.0, backlash=0.001, gears=special))
    vectors = np.stack((gears.friction, gears.half_backlash, gears.feed_forward, gears.strength), axis=1)
    found = [vectors[ROBOT.index[joint]].tolist() for joint in ("l_knee_pitch", "r_elbow_pitch", "r_wrist_yaw")]
    assert found == [[2.0, 0.0005, 1.0, 1.0], [1.2, 0.02, 0.0, 1.0], [6.0, 0.0005, 1.0, 0.5]]


def test_gears_without_feed_forward_go_by_position_alone_and_weak_motors_give_their_share() -> None:
    profile = ActuatorProfile(gears={"l_elbow_pitch": Gear(feed_forward=False), "r_wrist_yaw": Gear(strength=0.1)})
    result = effort(motor(JointMode.IMPEDANCE, position=0.1, effort=5.0, stiffness=10.0), REST, REST, profile)
    shoulder, elbow, wrist = (ROBOT.index[name] for name in ("l_shoulder_pitch", "l_elbow_pitch", "r_wrist_yaw"))
    assert (result[shoulder], result[elbow], result[wrist]) == pytest.approx((6.0, 1.0, 0.6))


def test_holding_keeps_the_joints_where_they_are() -> None:
    actuators = Actuators(ROBOT, IDEAL, STEP)
    actuators.obey(motor(JointMode.FORCE, sequence=7, effort=5.0))
    actuators.update(REST, REST)
    here = ROBOT.nominal_posture
    actuators.hold(here)
    np.testing.assert_array_equal(actuators.update(here, REST), 0.0)
    pulled = actuators.update(here + 0.001, REST + 0.01)
    expected = -ROBOT.servo_stiffness * 0.001 - ROBOT.servo_damping * 0.01
    np.testing.assert_allclose(pulled, expected)
    assert actuators.motor_sequence == 7
