"""The VRC's balance controller balances the robot through ``remote``: state, command and exchange by messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from harness.closed_loop import load_robot
from harness.robot_in_process import RobotInProcess
from harness.vrc_in_process import Commander, Network
from valor.common import topics
from valor.common.behaviors import Behavior
from valor.motion_manager.controllers import controller_factories
from valor.motion_manager.handlers.joint_commands import JointCommandsHandler
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import REMOTE, WHOLE_BODY
from valor.valor_ros_controller.core import Core

NAME = "balance_controller"


def make_vrc(robot: RobotDescription, node: Any, decimation: int, clock: Callable[[], float]) -> Core:
    commander: Any = Commander
    return Core(robot, node, commander, decimation=decimation, silence_timeout=1.0, clock=clock)


class Robot(RobotInProcess):
    """ESCHER in Stand with a VRC, whose commands arrive a period later."""

    def __init__(self, decimation: int) -> None:
        robot = load_robot(controllers={"stand": [WHOLE_BODY, REMOTE]})
        super().__init__(robot, "hardware", 1, others=controller_factories(robot))
        self.decimation = decimation
        self.exchange = self.manager.components.exchange
        self._handler = JointCommandsHandler(self.manager.components)
        self.start_vrc()
        self.each = self.cycle
        assert not (refused := self.stand_up()), refused
        self.run(1.0)

    def start_vrc(self) -> None:
        self.network = Network()
        self.vrc = make_vrc(self.manager.components.robot, self.network, self.decimation, lambda: self.time)

    def cycle(self) -> None:
        components = self.manager.components
        for topic, message in (
            (topics.PROPRIOCEPTOR, self.measured),
            (topics.MOTION_STATE, self.manager.report()),
            (topics.CONTROLLERS, self.exchange.status(self.manager.time)),
        ):
            self.network.topic(topic.name).publish(message)
        measured = self.vrc.wait()
        if measured or not self._sequence % 2:
            self.vrc.update(measured)
        if received := self.network.topic(topics.JOINT_COMMANDS.name).latest():
            assert self._handler.handle(received, self.manager.time), components.rejections.take()

    def choose(self) -> str:
        return self.exchange.choose(REMOTE, self.manager.components.state)


@pytest.mark.parametrize("decimation", [1, 2])
def test_the_robot_stands_under_the_vrc(decimation: int) -> None:
    robot = Robot(decimation)
    assert "no command" in robot.choose(), "it is inactive until a client activates it"
    assert robot.vrc.switch.switch([NAME], [], 2) == (True, "")
    robot.run(0.3)
    assert robot.exchange.active.name == WHOLE_BODY, "it is executed once chosen"
    assert not robot.choose()
    robot.run(1.5)
    assert robot.exchange.active.name == REMOTE, robot.exchange.reason
    before = robot.plant.data.qpos[:3].copy()
    robot.plant.push(np.array((0.05 * robot.manager.components.estimator.kinematics.mass, 0.0, 0.0)), 0.1)
    robot.run(4.0)
    assert robot.exchange.active.name == REMOTE and robot.behavior is Behavior.STAND, robot.exchange.reason
    assert np.abs(robot.plant.data.qpos[:3] - before).max() < 0.02


def test_a_restarted_vrc_regains_no_control() -> None:
    robot = Robot(1)
    robot.vrc.switch.switch([NAME], [], 2)
    robot.run(0.3)
    assert not robot.choose()
    robot.run(1.0)
    assert robot.exchange.active.name == REMOTE
    robot.start_vrc()
    robot.run(0.1)
    assert robot.exchange.active.name == WHOLE_BODY and "old; expected at most 0.006 s" in robot.exchange.reason
    robot.run_until(lambda: robot.behavior is not Behavior.STAND, 6.0)
    assert robot.behavior is Behavior.SOFT_STOP
    assert not robot.vrc.robots.controllers[NAME].active


def test_robots_without_remote_lack_it() -> None:
    vrc = make_vrc(load_robot(), Network(), 2, lambda: 0.0)
    assert NAME not in vrc.robots.controllers and "gravity_offset" in vrc.robots.controllers
