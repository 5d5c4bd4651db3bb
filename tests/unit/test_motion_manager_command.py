"""What leaves for the motors: within the limits, finite, and without a jump from servos to balance."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.places import ROBOTS
from valor.common.arrays import FloatArray
from valor.common.messages import JointMode, Motor
from valor.control.controller import JointCommand
from valor.control.motor_command import MotorCommand
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")
N = len(ROBOT.joints)
CONTROL = np.array([joint.control for joint in ROBOT.tables.joints.values()])
FORCE, IMPEDANCE = CONTROL == "force", CONTROL == "impedance"
COMPLIANT = FORCE | IMPEDANCE
LED = COMPLIANT.copy()  # and the waist's, whatever drives it
LED[ROBOT.group_indices("torso")] = True
LIMIT = ROBOT.effort_limit
STIFFNESS, DAMPING = (np.where(FORCE, 0.0, gains) for gains in (ROBOT.servo_stiffness, ROBOT.servo_damping))
seeds = st.integers(0, 2**32 - 1)


def wish(rng: np.random.Generator, scale: float = 0.5) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions within their limits, velocities, and efforts of so many times their limits at most."""
    position = rng.uniform(np.maximum(ROBOT.lower, -1.0), np.minimum(ROBOT.upper, 1.0))
    return position, rng.uniform(-1.0, 1.0, N), scale * rng.uniform(-1.0, 1.0, N) * LIMIT


def whole_body(position: FloatArray, velocity: FloatArray, effort: FloatArray) -> JointCommand:
    return JointCommand(position, velocity, effort, STIFFNESS, DAMPING)


def said(command: MotorCommand) -> Motor:
    return command.message(7, 8, 9, "stand")


def torque(motor: Motor, position: FloatArray, velocity: FloatArray) -> FloatArray:
    """Of every compliant joint, as ``JointMode`` has it, measured there [N·m]; of the others their set-point [rad]."""
    servo = motor.stiffness * (motor.position - position) + motor.damping * (motor.velocity - velocity)
    free = -motor.damping * velocity
    compliant = motor.effort + np.where(motor.mode == JointMode.IMPEDANCE, servo, free)
    return np.where(COMPLIANT, compliant, motor.position)


@given(seeds, st.floats(0.01, 0.99))
@examples(30)
def test_balance_takes_over_linearly_from_the_servos(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    held, wanted, (position, velocity, _) = wish(rng), wish(rng), wish(rng)
    command, torques = MotorCommand(ROBOT), []
    for part in (0.0, share, 1.0):
        command.balance(whole_body(*wanted), *held, part)
        torques.append(torque(said(command), position, velocity))
    np.testing.assert_allclose(torques[1], share * torques[2] + (1.0 - share) * torques[0], atol=1e-9)
    command.hold(*held)
    np.testing.assert_allclose(torque(said(command), position, velocity), torques[0], atol=1e-9)
    np.testing.assert_allclose(torques[2][FORCE], wanted[2][FORCE])
    assert command.saturations == 0


@given(seeds, st.floats(0.5, 4.0), st.booleans())
@examples(30)
def test_whatever_is_wanted_leaves_within_the_limits(seed: int, scale: float, balance: bool) -> None:
    rng = np.random.default_rng(seed)
    (position, velocity, effort), (led, led_velocity, wanted) = wish(rng, scale), wish(rng, scale)
    position, led = scale * position, scale * led
    command = MotorCommand(ROBOT)
    if balance:
        command.balance(whole_body(led, led_velocity, wanted), position, velocity, effort, 1.0)
        position, velocity = np.where(LED, led, position), np.where(LED, led_velocity, velocity)
        effort = wanted
    else:
        command.hold(position, velocity, effort)
    motor = said(command)
    np.testing.assert_allclose(motor.position, np.clip(position, ROBOT.lower, ROBOT.upper))
    np.testing.assert_allclose(motor.velocity, velocity)
    np.testing.assert_allclose(motor.effort, np.where(COMPLIANT, np.clip(effort, -LIMIT, LIMIT), 0.0))
    assert command.saturations == np.count_nonzero(COMPLIANT & (np.abs(effort) >= LIMIT))
    assert (motor.time, motor.sequence, motor.proprioceptor_sequence, motor.behavior) == (7, 8, 9, "stand")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("what", range(3))
@pytest.mark.parametrize("led", [False, True])
def test_what_is_not_finite_repeats_the_last_at_rest_and_damped(value: float, what: int, led: bool) -> None:
    rng = np.random.default_rng(1)
    command = MotorCommand(ROBOT)
    command.balance(whole_body(*wish(rng)), *wish(rng), 1.0)
    before = said(command)
    good, broken = wish(rng), wish(rng)
    broken[what][int(np.flatnonzero(FORCE)[3])] = value
    if led:
        command.balance(whole_body(*broken), *good, 1.0)
    else:
        command.hold(*broken)
    motor = said(command)
    assert command.replaced == 1
    np.testing.assert_array_equal(motor.mode, before.mode)
    np.testing.assert_array_equal(motor.position, before.position)
    np.testing.assert_array_equal(motor.effort, before.effort)
    np.testing.assert_array_equal(motor.stiffness, before.stiffness)
    assert not motor.velocity.any()
    np.testing.assert_array_equal(
        motor.damping, np.maximum(before.damping, np.where(COMPLIANT, ROBOT.servo_damping, 0))
    )
    command.hold(*good)
    assert command.replaced == 1
    np.testing.assert_array_equal(said(command).position, good[0])


def test_limp_is_damping_alone() -> None:
    rng = np.random.default_rng(2)
    command = MotorCommand(ROBOT)
    command.hold(*wish(rng))
    measured = 3.0 * wish(rng)[0]
    command.limp(measured)
    motor = said(command)
    np.testing.assert_array_equal(motor.mode, np.where(COMPLIANT, JointMode.FORCE, JointMode.OFF))
    np.testing.assert_array_equal(motor.position, np.clip(measured, ROBOT.lower, ROBOT.upper))
    np.testing.assert_array_equal(motor.damping, np.where(COMPLIANT, ROBOT.servo_damping, 0.0))
    assert not motor.velocity.any() and not motor.effort.any() and not motor.stiffness.any()


@given(seeds)
@examples(30)
def test_no_servo_makes_more_of_a_command_than_its_joint_may_bear(seed: int) -> None:
    rng = np.random.default_rng(seed)
    command, (position, velocity, _) = MotorCommand(ROBOT), wish(rng)
    stiffness, damping = rng.uniform(0.0, 20.0, N) * ROBOT.servo_stiffness, ROBOT.servo_damping
    command.measure(position, velocity)
    command.balance(JointCommand(*wish(rng), stiffness, damping), *wish(rng), 1.0)
    motor = said(command)
    own = np.abs(motor.effort + damping * (motor.velocity - velocity))  # without the spring
    inside = LED & COMPLIANT & (own < LIMIT)
    assert (np.abs(torque(motor, position, velocity))[inside] <= LIMIT[inside] * (1 + 1e-9)).all()
    assert (np.abs(motor.effort[COMPLIANT]) <= LIMIT[COMPLIANT]).all()


def test_a_command_that_no_servo_makes_too_much_of_is_sent_as_it_is() -> None:
    rng = np.random.default_rng(5)
    position, velocity, effort = wish(rng, 0.1)
    sent = []
    for measured in (False, True):
        command = MotorCommand(ROBOT)
        if measured:
            command.measure(position + 1e-3, velocity)
        command.balance(JointCommand(position, velocity, effort, STIFFNESS, DAMPING), position, velocity, effort, 1.0)
        sent.append(said(command))
    np.testing.assert_array_equal(sent[0].position, sent[1].position)
