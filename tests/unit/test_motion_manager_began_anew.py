"""A Motion Manager that finds a robot which another one has led: it holds what it finds, and waits for a command."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from harness.still_robot import PERIOD, ROBOT, Robot, tilted
from valor.common.behaviors import Behavior
from valor.common.messages import JointMode
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.motion_manager.states.transitions import RESUMED, WAY_BACK

ARMS = [*ROBOT.group_indices("left_arm"), *ROBOT.group_indices("right_arm")]
FOUND = ROBOT.nominal_posture.copy()  # but for the arms
FOUND[ARMS] = np.clip(FOUND[ARMS] + 0.4, ROBOT.lower[ARMS], ROBOT.upper[ARMS])
BALANCED = [behavior for behavior in Behavior if behavior.balancing]


def begin(behavior: str, seconds: float = 0.2, **changes: Any) -> Robot:
    """A new process' Motion Manager in its first periods with a robot that was left in a behavior."""
    robot = Robot()
    robot.run(seconds, motor_behavior=behavior, **changes)
    return robot


@pytest.mark.parametrize("behavior", Behavior)
def test_the_table_has_every_behavior_and_a_way_to_where_it_leads(behavior: Behavior) -> None:
    fsm = BehaviorFsm()
    for step in WAY_BACK[RESUMED[behavior]]:
        fsm.go(step, "on the way")
    assert fsm.behavior is RESUMED[behavior]
    assert fsm.behavior in (Behavior.IDLE, Behavior.FREEZE, Behavior.FALL), "only where nothing moves"


@pytest.mark.parametrize("behavior", [*Behavior, "of_a_later_version"])
def test_no_joint_is_moved(behavior: str) -> None:
    robot = begin(behavior, joint_position=FOUND)
    expected = RESUMED.get(Behavior(behavior), Behavior.FREEZE) if behavior in list(Behavior) else Behavior.FREEZE
    assert robot.behavior is expected
    assert f"before, the robot was in {behavior}" in robot.manager.fsm.reason
    motor = robot.motor
    assert motor is not None and motor.behavior == expected
    if expected is Behavior.FALL:
        assert not motor.effort.any() and not motor.stiffness.any()
        assert (motor.mode != JointMode.POSITION).all()
    else:
        assert np.array_equal(motor.position, FOUND)
        assert not motor.velocity.any()


@pytest.mark.parametrize("behavior", BALANCED)
@pytest.mark.parametrize(
    ("condition", "reason"),
    [
        ({"imu_orientation": tilted(0.9)}, "the pelvis is tilted"),
        ({"left_foot_wrench": np.zeros(6)}, "the left foot carries 0 N"),
    ],
)
def test_one_that_balanced_and_does_not_stand_any_more_is_let_go(
    behavior: Behavior, condition: dict[str, Any], reason: str
) -> None:
    robot = begin(behavior, **condition)
    assert robot.behavior is Behavior.FALL
    assert reason in robot.manager.fsm.reason


def test_a_frozen_one_is_held_however_it_lies() -> None:
    assert begin(Behavior.FREEZE, imu_orientation=tilted(1.5)).behavior is Behavior.FREEZE


def test_it_moves_again_by_a_command() -> None:
    robot = begin(Behavior.STAND)
    assert robot.behavior is Behavior.FREEZE
    assert not robot.ask(Behavior.STAND_PREP)
    robot.run(1.0)
    assert not robot.ask(Behavior.STAND)


@pytest.mark.parametrize("behavior", [*Behavior, "of_a_later_version"])
def test_what_the_devices_say_later_of_the_behavior_changes_nothing_but_for_a_stop(robot: Robot, behavior: str) -> None:
    """It is the devices' memory, and was read when the robot was found; but somebody may have stopped it there."""
    robot.run(0.3)
    robot.run(0.3, motor_behavior=behavior)
    assert robot.behavior == (behavior if behavior in ("fall", "freeze") else Behavior.STAND_PREP)
    assert behavior not in ("fall", "freeze") or f"was told to: {behavior}" in robot.manager.fsm.reason


def test_a_robot_in_stand_prep_that_lived_alone_for_a_while_is_held() -> None:
    robot = Robot()
    robot.run(0.1, joint_position=FOUND)
    robot.tick(elapsed=500 * PERIOD, joint_position=FOUND)
    assert robot.behavior is Behavior.FREEZE
    assert "no Proprioceptor for 1.000 s" in robot.manager.fsm.reason
    robot.run(1.0, joint_position=FOUND)
    assert robot.motor is not None and np.array_equal(robot.motor.position, FOUND)


@pytest.fixture
def robot() -> Robot:
    return Robot()
