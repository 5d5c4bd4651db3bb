"""The balance reflex: a robot whose Motion Manager dies while it walks comes to stand; held at once, it would fall."""

import numpy as np
import pytest

from harness.still_robot import ROBOT, N, Robot
from harness.walking_robot import Then, WalkingRobot
from valor.common.behaviors import INTERNAL_STATES, REFLEX, Behavior, Locomotion
from valor.whole_body.reflex import FAULTY, BalanceReflex

VELOCITY = (0.3, 0.0, 0.0)
STEP = 0.66  # of a step at it [s]
PHASES = 4  # of two steps
STEPPING = (Locomotion.STEP, Locomotion.WALK)
LIFTED = {"left_foot_wrench": np.zeros(6)}


@pytest.fixture(scope="module")
def reflex() -> BalanceReflex:
    return BalanceReflex(ROBOT)


def test_a_walking_robot_left_alone_comes_to_stand_whenever_it_is() -> None:
    walking = WalkingRobot(ROBOT, "hardware", 0)
    first = np.random.default_rng(0).uniform(0.0, 2.0 * STEP / PHASES)
    walking.walk(VELOCITY, 2.0 + first)
    ends = []
    for _ in range(PHASES):
        ends.append(walking.abandon(Then.REFLEX, blind=5))
        if walking.manager.report().contacts.sum() == 1:
            assert walking.abandon(Then.HOLD, blind=5).fell, "the reflex is not needed"
        walking.walk(VELOCITY, 2.0 * STEP / PHASES)
    assert not any(end.fell for end in ends), ends
    assert all(end.outcome.startswith("it stands") for end in ends), ends


@pytest.mark.parametrize("behavior", [*Behavior, "", "of_a_later_version"])
def test_it_is_for_robots_that_step_or_balance_on_one_foot(reflex: BalanceReflex, behavior: str) -> None:
    locomotion = INTERNAL_STATES[Behavior(behavior)][0] if behavior in list(Behavior) else None
    robot = Robot()
    assert reflex.needed(behavior, robot.proprioceptor()) is (locomotion in STEPPING)
    assert reflex.needed(behavior, robot.proprioceptor(**LIFTED)) is (locomotion is not None and locomotion.balancing)


def begun(reflex: BalanceReflex) -> Robot:
    robot = Robot()
    robot.tick()
    assert robot.motor is not None
    reflex.begin(robot.motor)
    assert not reflex.done
    return robot


def test_a_robot_that_stands_is_given_back_soon(reflex: BalanceReflex) -> None:
    robot = begun(reflex)
    while not reflex.done:
        robot.tick()
        motor = reflex.update(robot.proprioceptor())
        robot.check(motor)
        assert motor.behavior == REFLEX
    assert reflex.outcome.startswith("it stands") and reflex.time < 1.0


@pytest.mark.parametrize("demand", [{"limp": True}, {}], ids=["devices", "fall"])
def test_what_cannot_be_balanced_is_let_go(reflex: BalanceReflex, demand: dict[str, bool]) -> None:
    robot = begun(reflex)
    lying = {} if demand else {"imu_orientation": np.array([np.cos(0.5), 0.0, np.sin(0.5), 0.0])}
    motor = reflex.update(robot.proprioceptor(**lying), **demand)
    assert reflex.done
    assert motor.behavior == Behavior.FALL and not motor.effort.any() and not motor.stiffness.any()


def test_devices_that_demand_to_be_held_are_held_once_both_feet_stand(reflex: BalanceReflex) -> None:
    robot = begun(reflex)
    reflex.update(robot.proprioceptor(), hold=True)
    assert reflex.done
    reflex.begin(robot.tick())
    for _ in range(10):
        robot.tick()
        reflex.update(robot.proprioceptor(**LIFTED), hold=True)
    assert not reflex.done


def test_states_that_cannot_be_accepted_end_it(reflex: BalanceReflex) -> None:
    robot = begun(reflex)
    reflex.update(robot.proprioceptor())
    for _ in range(round(FAULTY / ROBOT.control_period)):
        assert not reflex.done
        robot.check(reflex.update(robot.proprioceptor(joint_position=np.full(N, np.nan))))
    assert reflex.done
