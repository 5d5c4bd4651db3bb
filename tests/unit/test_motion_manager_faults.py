"""Proprioceptors that make no sense, commands that are not finite, errors: each Proprioceptor gets its sound Motor."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bifrost import Received
from harness.examples import examples
from harness.still_robot import PERIOD, ROBOT, N, Robot
from harness.waiting import some
from valor.common.behaviors import Behavior
from valor.common.messages import JointSetpoints
from valor.motion_manager.handlers.joint_setpoints import JointSetpointsHandler
from valor.motion_manager.locomotion.balance import LONGEST_INFEASIBLE
from valor.motion_manager.manager import FAULTY
from valor.whole_body.command import QpStatus, WholeBodyCommand


@pytest.fixture
def robot() -> Robot:
    return Robot()


@pytest.fixture
def standing(robot: Robot) -> Robot:
    return robot.stand()


BROKEN: dict[str, np.ndarray] = {
    "joint_position": np.full(N, np.nan),
    "joint_velocity": np.zeros(N - 1),
    "joint_effort": np.full(N, np.inf),
    "imu_orientation": np.zeros(4),
    "imu_angular_velocity": np.zeros(0),
    "imu_linear_acceleration": np.array([0.0, np.nan, 0.0]),
    "left_foot_wrench": np.zeros(7),
    "right_hand_wrench": np.full(6, -np.inf),
}


@pytest.mark.parametrize("name", BROKEN)
def test_one_broken_proprioceptor_is_survived_but_several_are_a_fall(standing: Robot, name: str) -> None:
    before = some(standing.motor)
    motor = standing.tick(**dict[str, Any]({name: BROKEN[name]}))
    assert standing.behavior is Behavior.STAND
    assert np.array_equal(motor.effort, before.effort) and (motor.damping >= before.damping).all()
    (rejection,) = standing.manager.rejections.take()
    assert name in rejection.reason
    standing.run(0.5)
    for _ in range(round(FAULTY / ROBOT.control_period)):
        assert standing.behavior is Behavior.STAND
        motor = standing.tick(**dict[str, Any]({name: BROKEN[name]}))
    assert standing.behavior is Behavior.FALL and name in standing.manager.fsm.reason
    assert not motor.effort.any()


def test_a_robot_that_never_makes_sense_is_never_in_control(robot: Robot) -> None:
    for _ in range(50):
        motor = robot.tick(joint_position=np.full(N, np.nan))
    assert not motor.effort.any()
    assert robot.behavior is Behavior.IDLE and not robot.manager.authority.in_control


def interfere(robot: Robot, change: Callable[[WholeBodyCommand], WholeBodyCommand]) -> None:
    """Spoil what the Whole-Body Controller commands."""
    update = robot.manager.components.whole_body.update
    robot.manager.components.whole_body.update = lambda *arguments: change(update(*arguments))  # type: ignore[method-assign]


def test_a_command_that_is_not_finite_never_leaves(standing: Robot) -> None:
    before = some(standing.motor)
    interfere(standing, lambda command: replace(command, effort=np.full(N, np.nan)))
    motor = standing.tick()
    assert np.array_equal(motor.effort, before.effort)
    assert standing.manager.components.command.replaced == 1


def test_an_infeasible_qp_leads_to_soft_stop_and_not_at_once(standing: Robot) -> None:
    interfere(standing, lambda command: replace(command, qp_status=QpStatus.INFEASIBLE))
    for _ in range(round(LONGEST_INFEASIBLE / ROBOT.control_period) - 1):
        standing.tick()
        assert standing.behavior is Behavior.STAND
    standing.tick()
    assert standing.behavior is Behavior.SOFT_STOP and "infeasible for 25 periods" in standing.manager.fsm.reason
    standing.run(0.2)
    assert standing.behavior is Behavior.SOFT_STOP


def test_an_error_of_ours_repeats_the_last_command_and_then_falls(standing: Robot) -> None:
    before = some(standing.motor)

    def fail(command: WholeBodyCommand) -> WholeBodyCommand:
        raise RuntimeError("broken on purpose")

    interfere(standing, fail)
    motor = standing.tick()
    assert np.array_equal(motor.effort, before.effort)
    assert standing.behavior is Behavior.STAND
    for _ in range(round(FAULTY / ROBOT.control_period)):
        motor = standing.tick()
    assert standing.behavior is Behavior.FALL
    assert not motor.effort.any()


values = st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1.0, -3.0, 1e9, 1e300])
numbers = st.one_of(st.floats(), st.floats(-1e3, 1e3), st.floats(-4.0, 4.0))  # any at all, absurd, and believable
slips = st.tuples(st.sampled_from([*BROKEN]), st.integers(0, N - 1), numbers)


@examples(12)
@given(st.data())
@np.errstate(all="ignore")
def test_whatever_happens_every_proprioceptor_gets_its_sound_motor(data: st.DataObject) -> None:
    """Also while it balances, and single sensors fail."""
    robot = Robot().stand() if data.draw(st.booleans()) else Robot()
    robot.run(0.9)
    for _ in range(data.draw(st.integers(1, 12))):
        event = data.draw(st.sampled_from(["ask", "broken", "slips", "gap", "anew", "setpoint", "nothing"]))
        if event == "ask":
            robot.ask(data.draw(st.sampled_from(Behavior)))
        elif event == "broken":
            name = data.draw(st.sampled_from([*BROKEN]))
            value = np.full(data.draw(st.sampled_from([N, 3, 4, 6, 0])), data.draw(values))
            for _ in range(data.draw(st.integers(1, 7))):
                robot.tick(**dict[str, Any]({name: value}))
        elif event == "slips":
            sound, changes = robot.proprioceptor(), dict[str, Any]()
            for name, place, number in data.draw(st.lists(slips, min_size=1, max_size=6)):
                vector = changes.setdefault(name, getattr(sound, name).copy())
                vector[place % len(vector)] = number
            robot.tick(**changes)
        elif event == "gap":
            robot.tick(elapsed=PERIOD * data.draw(st.integers(1, 100)))
        elif event == "anew":
            robot.time = 0
        elif event == "setpoint":
            position = np.full(1, data.draw(values))
            message = JointSetpoints(robot.time, ["neck_yaw"], position, np.zeros(1), np.zeros(1))
            JointSetpointsHandler(robot.manager.components).handle(
                Received(message, 0, 1, "somebody"), robot.manager.time
            )
        robot.run(0.04)
        assert robot.manager.authority.in_control
