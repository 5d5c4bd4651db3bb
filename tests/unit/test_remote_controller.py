"""``remote`` executes a live stream of joint commands; a stream that fails is replaced before the robot falls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import pytest

from bifrost import Received
from harness.closed_loop import load_robot
from harness.robot_in_process import RobotInProcess
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.common.errors import ConfigurationError
from valor.common.messages import JointCommands
from valor.control.controller import JointTargets, Request
from valor.motion_manager.controllers import controller_factories
from valor.motion_manager.handlers.joint_commands import JointCommandsHandler
from valor.robot.motion_tables import REMOTE, WHOLE_BODY
from valor.whole_body.controller import WholeBodyController

FIELDS = ("position", "velocity", "effort", "stiffness", "damping")
LISTED = {"stand": [WHOLE_BODY, REMOTE]}


@dataclass
class Sender:
    """A Whole-Body Controller outside the Motion Manager; its messages arrive a period later."""

    robot: RobotInProcess
    spoil: Callable[[JointCommands], list[JointCommands]] = lambda message: [message]  # what is sent instead
    sequence: int = 0

    def __post_init__(self) -> None:
        components = self.robot.manager.components
        self._handler = JointCommandsHandler(components)
        self._controller = WholeBodyController(components.robot, components.estimator.kinematics)
        self._controller.may_recover = False

    def send(self) -> None:
        components = self.robot.manager.components
        state, robot = components.state, components.robot
        assert state is not None
        exchange = components.exchange
        if REMOTE not in (exchange.active.name, exchange.pending):
            self._controller.begin(state)
        still = np.zeros(len(robot.joints))
        gains = robot.servo_stiffness, robot.servo_damping
        targets = JointTargets(components.reference.position, still, still, *gains)
        command = self._controller.update(state, Request(targets), robot.control_period)
        joints = np.flatnonzero(self._controller.joints)
        names = [robot.joints[joint] for joint in joints]
        numbers = {name: getattr(command, name)[joints] for name in FIELDS}
        message = JointCommands(time=state.time, period=robot.control_period, names=names, **numbers)
        for each in self.spoil(message):
            self.sequence += 1
            self._handler.handle(Received(each, 0, self.sequence, "valor_ros_controller"), self.robot.manager.time)


class Robot(RobotInProcess):
    """ESCHER in Stand, with ``remote`` and a sender."""

    def __init__(self) -> None:
        robot = load_robot(controllers=LISTED)
        super().__init__(robot, "hardware", 1, others=controller_factories(robot))
        assert not (refused := self.stand_up()), refused
        self.run(0.6)
        self.sender = Sender(self)
        self.each = self.sender.send
        self.exchange = self.manager.components.exchange
        self.run(0.1)

    def choose(self) -> str:
        return self.exchange.choose(REMOTE, self.manager.components.state)

    def rejections(self) -> list[str]:
        rejections = self.manager.rejections
        rejections._published.clear()  # else one of a kind is published, of those within a moment
        return [rejection.reason for rejection in rejections.take()]


@pytest.fixture
def robot() -> Robot:
    """Under ``remote``."""
    robot = Robot()
    assert robot.exchange.active.name == WHOLE_BODY, "a stream alone moves nothing"
    assert not robot.choose()
    robot.run(0.8)
    assert robot.exchange.active.name == REMOTE, robot.exchange.reason
    return robot


def with_nan(vector: FloatArray) -> FloatArray:
    spoiled = vector.copy()
    spoiled[3] = np.nan
    return spoiled


Change = Callable[[JointCommands], list[JointCommands]]


def changed(**fields: Callable[[Any], Any]) -> Change:
    def change(message: JointCommands) -> list[JointCommands]:
        made = {name: make(getattr(message, name)) for name, make in fields.items()}
        return [msgspec.structs.replace(message, **made)]

    return change


# What is sent instead, and part of the rejection.
AT_THE_EDGE: dict[str, tuple[Change, str]] = {
    "not a number": (changed(effort=with_nan), "is nan; expected a finite number"),
    "ahead": (changed(time=lambda time: time + 10**9), "ahead of robot time; expected"),
    "unknown joint": (changed(names=lambda names: ["tail", *names[1:]]), "unknown joint 'tail'"),
    "twice": (changed(names=lambda names: [names[1], *names[1:]]), "is named twice"),
    "no leg": (
        changed(**dict.fromkeys(("names", *FIELDS), lambda values: values[1:])),
        "is missing; expected all of left_leg, right_leg, torso",
    ),
    "shorter": (changed(position=lambda vector: vector[1:]), "numbers for"),
    "negative": (changed(damping=lambda vector: vector - 1.0), "is -1; expected 0 to"),
    "stiff": (changed(stiffness=lambda vector: vector + 1e6), "expected 0 to"),
    "slow": (changed(period=lambda period: 1.0), "the period is 1 s; expected"),
    "late": (changed(time=lambda time: time - 8_000_000), "0.008 s old; expected at most 0.006 s, 3 of its periods"),
    "repeated": (lambda message: [message, message], "0.000 s before the last one's; expected a newer"),
}


def test_a_wrong_command_is_rejected_with_problem_value_and_expectation() -> None:
    robot = Robot()
    for spoil, named in AT_THE_EDGE.values():
        robot.run(0.02)
        robot.rejections()
        robot.sender.spoil = spoil
        robot.step()
        robot.sender.spoil = lambda message: [message]
        (reason,) = robot.rejections()
        assert named in reason


@pytest.mark.parametrize("what", ["silence", "late", "old", "not a number"])
def test_a_stream_that_fails_is_replaced_before_the_robot_falls(robot: Robot, what: str) -> None:
    height, first = robot.plant.data.qpos[2], robot.manager.time
    changes: dict[str, Change] = {"silence": lambda _: [], "old": changed(time=lambda time: first)}
    changes |= {name: change for name, (change, _) in AT_THE_EDGE.items()}
    robot.sender.spoil = changes[what]
    robot.run(0.2)
    assert robot.exchange.active.name == WHOLE_BODY
    assert robot.run_until(lambda: robot.behavior is Behavior.SOFT_STOP, 5.0)
    assert "remote: no command for" in robot.manager.fsm.reason
    assert "s old; expected at most 0.006 s, 3 of its periods" in robot.manager.fsm.reason
    assert abs(robot.plant.data.qpos[2] - height) < 0.02
    robot.sender.spoil = lambda message: [message]
    assert not robot.stand_up()
    robot.run(1.5)
    assert robot.exchange.active.name == WHOLE_BODY and robot.behavior is Behavior.STAND, "it regains no control"


def test_a_burst_after_a_pause_moves_nothing_but_by_its_latest(robot: Robot) -> None:
    held: list[JointCommands] = []

    def hold(message: JointCommands) -> list[JointCommands]:
        held.append(message)
        return [] if len(held) % 10 else held[-10:] * 20

    robot.sender.spoil = hold
    robot.run(1.0)
    assert robot.exchange.active.name == REMOTE and robot.behavior is Behavior.STAND
    reasons = robot.rejections()
    assert any("before the last one's; expected a newer" in reason or "old; expected" in reason for reason in reasons)


@pytest.mark.parametrize("restarted", [False, True])
def test_a_sender_that_returns_is_to_be_chosen_again(robot: Robot, restarted: bool) -> None:
    assert not robot.ask(Behavior.SOFT_STOP)
    robot.run(0.2)
    if restarted:  # within the time of a stream, as in a world that waits for it
        robot.sender.sequence = 0
    else:
        robot.each = None
        robot.run(0.1)
        robot.each = robot.sender.send
    assert not robot.stand_up()
    robot.run(4.0)
    assert robot.exchange.active.name == WHOLE_BODY and "were interrupted; choose remote again" in robot.exchange.reason
    assert not robot.choose()
    robot.run(1.0)
    assert robot.exchange.active.name == REMOTE and robot.behavior is Behavior.STAND


def test_without_a_stream_it_is_not_chosen() -> None:
    robot = Robot()
    robot.each = None
    robot.run(0.05)
    assert "the last command is 0.0" in robot.choose()
    robot.each = robot.sender.send
    robot.run(1.0)
    assert robot.exchange.active.name == WHOLE_BODY


def test_it_may_not_be_the_first() -> None:
    with pytest.raises(ConfigurationError, match="remote is the first, which is used without a request"):
        controller_factories(load_robot(controllers={"stand": [REMOTE, WHOLE_BODY]}))


def test_a_robot_without_it_rejects_its_commands() -> None:
    robot = RobotInProcess(load_robot(), "hardware", 1)
    robot.run(0.1)
    sender = Sender(robot)
    sender.send()
    (rejection,) = robot.manager.rejections.take()
    assert "robot.yaml lists no controller remote; expected" in rejection.reason
