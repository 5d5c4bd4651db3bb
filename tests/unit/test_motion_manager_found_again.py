"""A robot that lived without the Motion Manager for a while, as when the Comms Manager dies; all in one process."""

from __future__ import annotations

import numpy as np
import pytest

from harness.closed_loop import load_robot
from valor.common.behaviors import Behavior
from valor.common.messages import BehaviorRequest
from valor.motion_manager.handlers.behavior import BehaviorHandler
from valor.motion_manager.manager import MotionManager
from valor.robot.model import controller_model
from valor.simulation.plant import Plant
from valor.simulation.sensors import Sensors

WATCHDOG = 0.1  # of the motor controllers, after which they hold their joints [s]
STANDING = 0.7  # of the pelvis, at least [m]


class Robot:
    """The plant of profile ``hardware``, led by the Motion Manager or by nobody."""

    def __init__(self, seed: int) -> None:
        self.robot = load_robot(control_rate=250.0)
        self.plant = Plant(self.robot, "flat", "hardware", seed)
        self.sensors = Sensors(self.robot, self.plant, self.robot.tables.actuators["hardware"].noise, seed)
        self.manager = MotionManager(self.robot, controller_model(self.robot))
        self._periods = 0
        self._substeps = round(self.robot.control_period / self.plant.step_time)
        self.plant.actuators.hold(self.robot.nominal_posture)

    def run(self, seconds: float, alone: bool = False) -> None:
        for _ in range(round(seconds / self.robot.control_period)):
            if not alone:
                time = round(1e9 * self._periods * self.robot.control_period)
                self.plant.actuators.obey(self.manager.tick(self.sensors.measure(self._periods, time)))
            self.plant.step(self._substeps)
            self._periods += 1

    def left_alone(self, seconds: float) -> None:
        """First the last Motor acts on; then every joint is held where it is."""
        self.run(WATCHDOG, alone=True)
        self.plant.actuators.hold(self.plant.joint_position.copy())
        self.run(seconds - WATCHDOG, alone=True)

    def go(self, behavior: Behavior) -> None:
        for _ in range(40):
            reply = BehaviorHandler.of(self.manager.parts).handle(BehaviorRequest(behavior), "test")
            if reply.accepted:
                return
            self.run(0.1)
        raise AssertionError(f"{behavior}: {reply.reason}")

    @property
    def behavior(self) -> str:
        return str(self.manager.fsm.behavior)

    @property
    def pelvis(self) -> np.ndarray:
        return np.array(self.plant.data.qpos[:3])


@pytest.mark.parametrize("seconds", [0.15, 2.0])
def test_a_robot_that_stood_is_held_and_stands_again_when_somebody_says_so(seconds: float) -> None:
    robot = Robot(seed=1)
    robot.run(1.0)
    robot.go(Behavior.STAND)
    robot.run(1.0)
    before = robot.pelvis
    robot.left_alone(seconds)
    robot.run(0.5)
    assert robot.behavior == "freeze"
    assert "it stands, and is held" in robot.manager.fsm.reason
    robot.go(Behavior.STAND_PREP)
    robot.go(Behavior.STAND)
    robot.run(1.0)
    assert robot.behavior == "stand"
    assert np.linalg.norm(robot.pelvis - before) < 0.05 and robot.pelvis[2] > STANDING
