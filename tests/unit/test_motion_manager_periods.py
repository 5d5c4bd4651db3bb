"""Period by period: a Motor for every Proprioceptor, no jump of any joint's torque, and joints within their stops."""

from typing import Any

import numpy as np
import pytest

from bifrost import Received
from harness.still_robot import LIMIT, PERIOD, ROBOT, N, Robot, tilted
from valor.common.behaviors import REFLEX, Behavior
from valor.common.messages import JointMode, VelocityCommand
from valor.motion_manager.handlers.motion import VelocityHandler
from valor.motion_manager.locomotion.landing import LONGEST, YIELDING
from valor.motion_manager.safety import RESUMED


@pytest.fixture
def robot() -> Robot:
    return Robot()


@pytest.fixture
def standing(robot: Robot) -> Robot:
    return robot.stand()


def test_it_starts_idle_and_goes_to_stand_prep_with_the_first_proprioceptor(robot: Robot) -> None:
    assert robot.behavior is Behavior.IDLE and "no comms_manager/proprioceptor yet" in robot.ask(Behavior.FREEZE)
    assert robot.manager.report(0.0).behavior == "idle"
    robot.tick()
    assert robot.behavior is Behavior.STAND_PREP and robot.manager.authority.in_control


def test_a_repeated_proprioceptor_is_answered_and_nothing_else(robot: Robot) -> None:
    for _ in range(100):
        robot.tick(elapsed=0)
    assert robot.behavior is Behavior.STAND_PREP and robot.manager.fsm.changes == 1
    robot.run(1.0)
    assert not robot.ask(Behavior.STAND)


def test_stand_prep_moves_slowly_from_wherever_the_joints_are(robot: Robot) -> None:
    rng = np.random.default_rng(3)
    found = np.clip(ROBOT.nominal_posture + rng.uniform(-0.5, 0.5, N), ROBOT.lower, ROBOT.upper)
    last = robot.tick(joint_position=found).position
    assert np.allclose(last, found)
    fastest = 0.0
    for _ in range(1500):
        position = robot.tick(joint_position=found).position
        fastest = max(fastest, float(np.abs(position - last).max()) / ROBOT.control_period)
        last = position
    assert np.allclose(last, ROBOT.nominal_posture)
    assert fastest < 0.65


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"imu_orientation": tilted(0.4)}, "the pelvis is tilted"),
        ({"imu_orientation": tilted(-1.5)}, "the pelvis is tilted"),
        ({"left_foot_wrench": np.zeros(6)}, "the left foot carries 0 N"),
        ({"right_foot_wrench": np.zeros(6)}, "the right foot carries 0 N"),
        ({"joint_velocity": np.full(N, 1.0)}, "has not settled: joint 'l_hip_yaw' moves at"),
    ],
)
def test_stand_is_refused_to_a_robot_that_cannot(robot: Robot, changes: dict[str, Any], reason: str) -> None:
    robot.run(1.0, **changes)
    assert reason in robot.ask(Behavior.STAND) and robot.behavior is Behavior.STAND_PREP


def test_nobody_slips_through_stand_prep_between_two_periods(standing: Robot) -> None:
    assert not standing.ask(Behavior.FREEZE) and not standing.ask(Behavior.STAND_PREP)
    assert "just started" in standing.ask(Behavior.STAND)
    standing.tick()
    assert "to go" in standing.ask(Behavior.STAND)


def test_operation_drives_each_joint_as_robot_yaml_states(standing: Robot) -> None:
    motor = standing.tick()
    expected = {"force": JointMode.FORCE, "impedance": JointMode.IMPEDANCE, "position": JointMode.POSITION}
    for i, joint in enumerate(ROBOT.tables.joints.values()):
        assert motor.mode[i] == expected[joint.control]
        assert motor.stiffness[i] == (0.0 if joint.control == "force" else joint.servo.stiffness)
    legs = np.concatenate((ROBOT.group_indices("left_leg"), ROBOT.group_indices("right_leg")))
    assert np.abs(motor.effort[legs]).max() > 10.0


@pytest.mark.parametrize(
    "path",
    [
        (Behavior.STAND,),
        (Behavior.STAND, Behavior.STAND_PREP),
        (Behavior.STAND, Behavior.FREEZE, Behavior.STAND_PREP, Behavior.STAND),
        (Behavior.STAND, Behavior.STAND_MANIPULATE, Behavior.FREEZE, Behavior.IDLE),
        (Behavior.STAND, Behavior.SOFT_STOP, Behavior.STAND, Behavior.STAND_PREP),
        (Behavior.STAND, Behavior.STAND_PREP, Behavior.IDLE, Behavior.STAND_PREP, Behavior.STAND),
    ],
)
@pytest.mark.parametrize("pause", [0.1, 0.8])
def test_no_change_of_behavior_makes_a_torque_jump(robot: Robot, path: tuple[Behavior, ...], pause: float) -> None:
    robot.run(1.0)
    before, largest = robot.torque(), np.zeros(N)

    def watch() -> None:
        nonlocal before, largest
        robot.tick()
        torque = robot.torque()
        largest, before = np.maximum(largest, np.abs(torque - before)), torque

    for behavior in path:
        for _ in range(1000):
            if not robot.ask(behavior):
                break
            watch()
        assert robot.manager.fsm.behavior is behavior
        for _ in range(round(pause / ROBOT.control_period)):
            watch()
    # A blend of 0.3 s from nothing to the largest torque, and half as much again for the controller's own dynamics.
    allowed = 1.5 * ROBOT.control_period / 0.3 * np.maximum(LIMIT, 30.0)
    assert (largest < allowed).all(), ROBOT.joints[int(np.argmax(largest / allowed))]


def test_a_restart_takes_the_joints_over_with_the_efforts_they_have(robot: Robot) -> None:
    effort = np.where(np.arange(N) < 27, 0.5 * LIMIT, 0.0)
    robot.tick(joint_effort=effort)
    assert np.allclose(robot.torque(), effort)


def test_a_fall_makes_the_motors_yield_in_the_same_period_and_limp_in_the_end(standing: Robot) -> None:
    motor = standing.tick(imu_orientation=tilted(1.2))  # the attitude's filter sees it within a few periods
    for _ in range(2000):
        if standing.behavior is Behavior.FALL:
            break
        motor = standing.tick(imu_orientation=tilted(1.2))
    assert standing.behavior is Behavior.FALL
    assert "tilted" in standing.manager.fsm.reason or "DCM" in standing.manager.fsm.reason
    assert not motor.effort.any() and (motor.stiffness <= YIELDING * ROBOT.servo_stiffness).all()
    standing.run(LONGEST)  # upright again
    assert standing.behavior is Behavior.FALL and not standing.tick().stiffness.any()


@pytest.mark.parametrize("behavior", [Behavior.STAND, Behavior.FREEZE, Behavior.FALL])
@pytest.mark.parametrize(("stop", "further"), [("upper", 0.05), ("lower", -0.05)])
def test_joints_beyond_stops_are_not_commanded_there(
    standing: Robot, behavior: Behavior, stop: str, further: float
) -> None:
    """``check`` looks at every Motor."""
    stops = getattr(ROBOT, stop)
    standing.ask(behavior)
    standing.run(0.01, joint_position=np.where(np.isfinite(stops), stops + further, 0.0))


# A robot that lived without its Motion Manager for a while, in another world, or led by the reflex: held or let go.
def test_a_world_begun_anew_is_a_fall(standing: Robot) -> None:
    standing.time, standing.sequence = 0, standing.sequence + 1_000_000
    motor = standing.tick()
    assert standing.behavior is Behavior.FALL and "another world" in standing.manager.fsm.reason
    assert not motor.effort.any()


def test_a_robot_that_stood_without_us_for_a_while_is_held(standing: Robot) -> None:
    standing.tick(elapsed=40 * PERIOD)
    assert standing.behavior is Behavior.STAND and standing.manager.missed == 39
    effort = np.where(np.arange(N) < 27, 0.1 * LIMIT, 0.0)
    motor = standing.tick(elapsed=60 * PERIOD, joint_effort=effort)
    assert standing.behavior is Behavior.FREEZE
    assert "no Proprioceptor for 0.120 s of robot time" in standing.manager.fsm.reason
    assert np.allclose(motor.position, ROBOT.nominal_posture) and np.allclose(standing.torque(), effort)
    standing.run(0.1)
    assert not standing.ask(Behavior.STAND_PREP)
    standing.run(1.0)
    assert not standing.ask(Behavior.STAND), "the way back"


@pytest.mark.parametrize(
    ("found", "why"),
    [
        ({"imu_orientation": tilted(0.5)}, "the pelvis is tilted"),
        ({"left_foot_wrench": np.zeros(6), "right_foot_wrench": np.zeros(6)}, "foot carries 0 N"),
    ],
)
def test_a_robot_that_is_found_lying_is_let_go(standing: Robot, found: dict[str, object], why: str) -> None:
    motor = standing.tick(elapsed=60 * PERIOD, **found)
    assert standing.behavior is Behavior.FALL and why in standing.manager.fsm.reason
    assert not motor.effort.any()


@pytest.fixture
def stepping(standing: Robot) -> Robot:
    assert not standing.ask(Behavior.WALK)
    VelocityHandler(standing.manager.components).handle(
        Received(VelocityCommand(standing.time, 0.2, 0.0, 0.0), 0, 1, "valor_ros_controller"), standing.time
    )
    for _ in range(1000):
        standing.tick()
        if standing.manager.components.conditions().stepping:
            break
    return standing


@pytest.mark.parametrize(
    ("speed", "found", "why"),
    [(1.0, Behavior.FALL, "it was stepping, and moves"), (0.0, Behavior.FREEZE, "it stands, and is held")],
)
def test_a_robot_that_was_stepping_without_us_is_let_go_unless_it_has_come_to_rest(
    stepping: Robot, speed: float, found: Behavior, why: str
) -> None:
    stepping.tick(elapsed=60 * PERIOD, joint_velocity=np.full(N, speed))
    assert stepping.behavior is found and why in stepping.manager.fsm.reason


def aside(robot: Robot, seconds: float = 0.1, **changes: Any) -> None:
    """The Comms Manager's reflex has the robot."""
    for _ in range(round(seconds / ROBOT.control_period)):
        motor = robot.tick(motor_behavior=REFLEX, **changes)
        assert motor.behavior == REFLEX
    assert "the Comms Manager is bringing the robot to stand" in robot.ask(Behavior.STAND)
    assert not robot.manager.authority.in_control


def test_a_new_motion_manager_waits_for_the_reflex_and_holds_what_it_leaves() -> None:
    robot = Robot()
    aside(robot, left_foot_wrench=np.zeros(6))
    assert robot.behavior is Behavior.SOFT_STOP
    found = np.clip(ROBOT.nominal_posture + 0.1, ROBOT.lower, ROBOT.upper)
    motor = robot.tick(motor_behavior="walk", joint_position=found)
    assert robot.behavior is Behavior.FREEZE
    assert np.array_equal(motor.position, found)
    robot.run(0.1)
    assert not robot.ask(Behavior.STAND_PREP)


def test_one_that_walked_and_was_stopped_does_not_go_on_walking(stepping: Robot) -> None:
    stepping.time += 100 * PERIOD
    aside(stepping, left_foot_wrench=np.zeros(6))
    assert stepping.behavior is Behavior.SOFT_STOP
    stepping.run(0.1, motor_behavior="walk")
    assert stepping.behavior is Behavior.FREEZE
    assert "the Comms Manager brought the robot to stand" in stepping.manager.fsm.reason


def test_what_the_reflex_leaves_on_one_foot_is_let_go(stepping: Robot) -> None:
    aside(stepping)
    stepping.run(0.1, motor_behavior="walk", left_foot_wrench=np.zeros(6))
    assert stepping.behavior is Behavior.FALL


def test_a_robot_that_was_let_go_stays_so_beside_the_reflex(standing: Robot) -> None:
    assert not standing.ask(Behavior.FALL)
    for _ in range(10):
        assert standing.tick(motor_behavior=REFLEX).behavior == Behavior.FALL
    standing.run(0.1, motor_behavior="fall")
    assert standing.behavior is Behavior.FALL


def test_in_stand_prep_a_new_world_is_held_as_it_is_found(robot: Robot) -> None:
    robot.run(1.0)
    robot.time = 0
    found = np.clip(ROBOT.nominal_posture + 0.1, ROBOT.lower, ROBOT.upper)
    motor = robot.tick(joint_position=found)
    assert robot.behavior is Behavior.FREEZE
    assert np.allclose(motor.position, found)
    assert not robot.ask(Behavior.STAND_PREP) and "just started" in robot.ask(Behavior.STAND)


# A Motion Manager that finds a robot which another one has led: it holds what it finds, and waits for a command.
ARMS = [*ROBOT.group_indices("left_arm"), *ROBOT.group_indices("right_arm")]
FOUND = ROBOT.nominal_posture.copy()  # but for the arms
FOUND[ARMS] = np.clip(FOUND[ARMS] + 0.4, ROBOT.lower[ARMS], ROBOT.upper[ARMS])
BALANCED = [behavior for behavior in Behavior if behavior.balancing]


def begin(behavior: str, seconds: float = 0.2, **changes: Any) -> Robot:
    """A new process' Motion Manager in its first periods with a robot that was left in a behavior."""
    robot = Robot()
    robot.run(seconds, motor_behavior=behavior, **changes)
    return robot


@pytest.mark.parametrize("behavior", [*Behavior, "of_a_later_version"])
def test_no_joint_is_moved(behavior: str) -> None:
    robot = begin(behavior, joint_position=FOUND)
    expected = RESUMED.get(Behavior(behavior), Behavior.FREEZE) if behavior in list(Behavior) else Behavior.FREEZE
    assert robot.behavior is expected and f"before, the robot was in {behavior}" in robot.manager.fsm.reason
    motor = robot.motor
    assert motor is not None and motor.behavior == expected
    if expected is Behavior.FALL:
        assert not motor.effort.any() and not motor.stiffness.any() and (motor.mode != JointMode.POSITION).all()
    else:
        assert np.array_equal(motor.position, FOUND) and not motor.velocity.any()


@pytest.mark.parametrize("behavior", BALANCED)
@pytest.mark.parametrize(
    ("condition", "reason"),
    [
        ({"imu_orientation": tilted(0.9)}, "the pelvis is tilted"),
        ({"left_foot_wrench": np.zeros(6)}, "the left foot carries 0 N"),
    ],
)
def test_one_that_balanced_and_fell_since_is_let_go(behavior: Behavior, condition: dict[str, Any], reason: str) -> None:
    robot = begin(behavior, **condition)
    assert robot.behavior is Behavior.FALL and reason in robot.manager.fsm.reason


def test_a_frozen_one_is_held_however_it_lies() -> None:
    assert begin(Behavior.FREEZE, imu_orientation=tilted(1.5)).behavior is Behavior.FREEZE


@pytest.mark.parametrize("behavior", [*Behavior, "of_a_later_version"])
def test_what_the_devices_say_later_of_the_behavior_changes_nothing_but_for_a_stop(behavior: str) -> None:
    """It is the devices' memory, and was read when the robot was found; but somebody may have stopped it there."""
    robot = begin("", 0.3)
    robot.run(0.3, motor_behavior=behavior)
    assert robot.behavior == (behavior if behavior in ("fall", "freeze") else Behavior.STAND_PREP)
    assert behavior not in ("fall", "freeze") or f"at the Comms Manager: {behavior}" in robot.manager.fsm.reason
