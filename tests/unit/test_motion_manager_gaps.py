"""A robot that lived without its Motion Manager for a while, in another world, or led by the reflex: held or let go."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bifrost import Received
from harness.still_robot import LIMIT, PERIOD, ROBOT, N, Robot, tilted
from valor.common.behaviors import REFLEX, Behavior
from valor.common.messages import VelocityCommand
from valor.motion_manager.handlers.velocity import VelocityHandler


@pytest.fixture
def robot() -> Robot:
    return Robot()


@pytest.fixture
def standing(robot: Robot) -> Robot:
    return robot.stand()


def test_a_world_begun_anew_is_a_fall(standing: Robot) -> None:
    standing.time, standing.sequence = 0, standing.sequence + 1_000_000
    motor = standing.tick()
    assert standing.behavior is Behavior.FALL
    assert "another world" in standing.manager.fsm.reason
    assert not motor.effort.any()


def test_a_robot_that_stood_without_us_for_a_while_is_held(standing: Robot) -> None:
    standing.tick(elapsed=40 * PERIOD)
    assert standing.behavior is Behavior.STAND
    assert standing.manager.missed == 39
    effort = np.where(np.arange(N) < 27, 0.1 * LIMIT, 0.0)
    motor = standing.tick(elapsed=60 * PERIOD, joint_effort=effort)
    assert standing.behavior is Behavior.FREEZE
    assert "no Proprioceptor for 0.120 s of robot time" in standing.manager.fsm.reason
    assert np.allclose(motor.position, ROBOT.nominal_posture) and np.allclose(standing.torque(), effort)
    standing.run(0.1)
    assert not standing.ask(Behavior.STAND_PREP)
    standing.run(1.0)
    assert not standing.ask(Behavior.STAND), "the way back"


def test_a_robot_that_walks_on_the_spot_is_held_too(standing: Robot) -> None:
    assert not standing.ask(Behavior.WALK)
    standing.run(0.1)
    standing.tick(elapsed=60 * PERIOD)
    assert standing.behavior is Behavior.FREEZE


@pytest.mark.parametrize(
    ("found", "why"),
    [
        ({"imu_orientation": tilted(0.5)}, "the pelvis is tilted"),
        ({"left_foot_wrench": np.zeros(6), "right_foot_wrench": np.zeros(6)}, "foot carries 0 N"),
    ],
)
def test_a_robot_that_is_found_lying_is_let_go(standing: Robot, found: dict[str, object], why: str) -> None:
    motor = standing.tick(elapsed=60 * PERIOD, **found)
    assert standing.behavior is Behavior.FALL
    assert why in standing.manager.fsm.reason
    assert not motor.effort.any()


@pytest.fixture
def stepping(standing: Robot) -> Robot:
    assert not standing.ask(Behavior.WALK)
    VelocityHandler.of(standing.manager.parts).handle(
        Received(VelocityCommand(standing.time, 0.2, 0.0, 0.0), 0, 1, "valor_ros_controller"), standing.time
    )
    for _ in range(1000):
        standing.tick()
        if standing.manager.parts.conditions().stepping:
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
    assert stepping.behavior is found
    assert why in stepping.manager.fsm.reason


def aside(robot: Robot, seconds: float = 0.1, **changes: Any) -> None:
    """The Comms Manager's reflex has the robot."""
    for _ in range(round(seconds / ROBOT.control_period)):
        motor = robot.tick(motor_behavior=REFLEX, **changes)
        assert motor.behavior == REFLEX
    assert "the Comms Manager brings the robot to stand" in robot.ask(Behavior.STAND)
    assert not robot.manager.custody.ours


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
    assert not robot.ask(Behavior.STAND_PREP)
    assert "begun" in robot.ask(Behavior.STAND)
