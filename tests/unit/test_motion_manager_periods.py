"""Period by period: a Motor for every Proprioceptor, no jump of any joint's torque, and joints within their stops."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from harness.still_robot import LIMIT, ROBOT, N, Robot, tilted
from valor.common.behaviors import Behavior
from valor.common.messages import JointMode


@pytest.fixture
def robot() -> Robot:
    return Robot()


@pytest.fixture
def standing(robot: Robot) -> Robot:
    return robot.stand()


def test_it_starts_idle_and_goes_to_stand_prep_with_the_first_proprioceptor(robot: Robot) -> None:
    assert robot.behavior is Behavior.IDLE
    assert "no comms_manager/proprioceptor yet" in robot.ask(Behavior.FREEZE)
    assert robot.manager.report(0.0).behavior == "idle"
    robot.tick()
    assert robot.behavior is Behavior.STAND_PREP
    assert robot.manager.custody.ours


def test_a_repeated_proprioceptor_is_answered_and_nothing_else(robot: Robot) -> None:
    for _ in range(100):
        robot.tick(elapsed=0)
    assert robot.behavior is Behavior.STAND_PREP
    assert robot.manager.fsm.changes == 1
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
    assert reason in robot.ask(Behavior.STAND)
    assert robot.behavior is Behavior.STAND_PREP


def test_stand_is_refused_until_stand_prep_has_finished(robot: Robot) -> None:
    robot.tick()
    assert "to go" in robot.ask(Behavior.STAND)


def test_nobody_slips_through_stand_prep_between_two_periods(standing: Robot) -> None:
    assert not standing.ask(Behavior.FREEZE)
    assert not standing.ask(Behavior.STAND_PREP)
    assert "just begun" in standing.ask(Behavior.STAND)
    standing.tick()
    assert "to go" in standing.ask(Behavior.STAND)


def test_operation_drives_each_joint_as_robot_yaml_says(standing: Robot) -> None:
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


def test_a_fall_makes_the_motors_limp_in_the_same_period(standing: Robot) -> None:
    motor = standing.tick(imu_orientation=tilted(1.2))  # the attitude's filter sees it within a few periods
    for _ in range(2000):
        if standing.behavior is Behavior.FALL:
            break
        motor = standing.tick(imu_orientation=tilted(1.2))
    assert standing.behavior is Behavior.FALL
    assert "tilted" in standing.manager.fsm.reason or "DCM" in standing.manager.fsm.reason
    assert not motor.effort.any()
    assert not motor.stiffness.any()
    standing.run(0.5)  # upright again
    assert standing.behavior is Behavior.FALL


@pytest.mark.parametrize("behavior", [Behavior.STAND, Behavior.FREEZE, Behavior.FALL])
@pytest.mark.parametrize(("stop", "further"), [("upper", 0.05), ("lower", -0.05)])
def test_joints_found_beyond_their_stops_are_not_commanded_there(
    standing: Robot, behavior: Behavior, stop: str, further: float
) -> None:
    """``check`` looks at every Motor."""
    stops = getattr(ROBOT, stop)
    standing.ask(behavior)
    standing.run(0.01, joint_position=np.where(np.isfinite(stops), stops + further, 0.0))
