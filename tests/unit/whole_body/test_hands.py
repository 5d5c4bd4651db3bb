"""Arms that go by position, with friction and play: they end where they are commanded, and what they are is found."""

import numpy as np
import pytest

from harness.closed_loop import load_robot
from harness.manipulating_robot import ManipulatingRobot
from valor.simulation.actuators import Gears

NEAR = np.array((0.4, -0.3, 0.2))  # a place of the right hand in pelvis [m]
MOST = 60.0  # that a hand presses with, as robot.yaml's default [N]


@pytest.fixture(scope="module")
def worn() -> ManipulatingRobot:
    """The arms as they were, a weight of 3 kg at each hand."""
    return ManipulatingRobot(load_robot(), "hdt_arms", seed=0, load=3.0)


def test_the_arms_are_found_to_go_by_position_and_their_play_is_measured(worn: ManipulatingRobot) -> None:
    servos = worn.manager.components.servos
    gears = Gears.of(worn.robot, worn.robot.tables.actuators["hdt_arms"])
    assert (servos.share < 0.1).all()
    loaded = servos.play > 0.0
    assert loaded.sum() >= 4
    np.testing.assert_allclose(servos.play[loaded], gears.half_backlash[servos.joints][loaded], atol=0.006)


def test_a_hand_with_a_load_ends_where_it_is_reported_and_estimates_how_far_off_it_is(worn: ManipulatingRobot) -> None:
    goal = worn.in_odom(NEAR, np.eye(3))
    worn.send(1, *goal)
    goals = worn.manager.components.hand_goals
    assert worn.run_until(lambda: goals.status(1, 0).state == "reached", 8.0), goals.status(1, 0)
    worn.run(0.5)
    off = float(np.linalg.norm(worn.hand(1)[0] - goal[0]))
    assert off < 0.012 and abs(off - goals.status(1, 0).position_error) < 0.006
    arm = worn.robot.group_indices("right_arm")
    lag = worn.plant.joint_position[arm] - worn.manager.components.reference.position[arm]
    assert np.abs(lag).max() < 0.012


def test_a_motor_that_takes_effort_is_left_to_it() -> None:
    robot = ManipulatingRobot(load_robot(), "hardware", seed=0)
    servos = robot.manager.components.servos
    assert (servos.share > 0.9).all() and (np.abs(servos.offset) < 0.02).all()


def test_what_is_said_to_be_wanted_is_the_set_point_and_not_what_makes_up_for_the_play(worn: ManipulatingRobot) -> None:
    """Whoever takes an arm over begins with what is said: with the offset in it the arm would move."""
    parts = worn.manager.components
    arm = worn.robot.group_indices("right_arm")
    worn.run(1.0)
    assert np.abs(parts.servos.offset).max() > 0.03
    said = parts.report(0, motor_time=0.0, tick_time=0.0).joint_setpoint
    np.testing.assert_allclose(said[arm], parts.reference.position[arm], atol=0.005)
    parts.hand_goals.release(1, "over")
    before = worn.plant.joint_position[arm]
    worn.follow(arm, said[arm])
    worn.run(0.5)
    np.testing.assert_allclose(worn.plant.joint_position[arm], before, atol=0.01)


def test_a_knock_leaves_a_goal_as_it_is_and_a_steady_force_lets_the_hand_go() -> None:
    robot = ManipulatingRobot(load_robot(), "ideal", seed=0)
    goals = robot.manager.components.hand_goals
    robot.send(1, *robot.in_odom(NEAR, np.eye(3)))
    assert robot.run_until(lambda: goals.status(1, 0).state == "reached", 8.0)
    press(robot, 1.5 * MOST, 0.06)
    robot.run(0.3)
    assert goals.leads(1)
    press(robot, 1.5 * MOST, 0.25)
    status = goals.status(1, 0)
    assert status.state == "resisted" and status.reason.startswith("it presses or lifts with ")
    assert not goals.leads(1)


def press(robot: ManipulatingRobot, force: float, seconds: float) -> None:
    """Aside against the right hand [N], for so long [s]."""
    hand = robot.robot.tables.hands.right
    assert hand is not None
    body, applied = robot.plant.model.body(hand.body), robot.plant.data.xfrc_applied
    for _ in range(round(seconds / robot.robot.control_period)):
        applied[body, 1] = force
        robot.step()
    applied[body, 1] = 0.0
