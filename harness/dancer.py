"""A robot in one process all of whose limbs follow sines, and that walks if it may."""

from __future__ import annotations

import numpy as np

from bifrost import Received
from harness.closed_loop import load_robot
from harness.robot_in_process import RobotInProcess
from valor.common.arrays import FloatArray
from valor.common.behaviors import LIMBS, Behavior
from valor.common.messages import BehaviorReply, BehaviorRequest, JointSetpoints, VelocityCommand
from valor.motion_manager.handlers.behavior import BehaviorHandler
from valor.motion_manager.handlers.joint_setpoints import JointSetpointsHandler
from valor.motion_manager.handlers.motion import VelocityHandler

ROBOT = load_robot()
JOINTS = {limb: ROBOT.group_indices(limb) for limb in LIMBS}


class Dancer(RobotInProcess):
    """Stands up, then goes a path of behaviors."""

    def __init__(self, *path: Behavior) -> None:
        super().__init__(ROBOT, "hardware", 1)
        components = self.manager.components
        self._behaviors, self.setpoints = BehaviorHandler(components), JointSetpointsHandler(components)
        self._velocities = VelocityHandler(components)
        self.each, self.wanted = self._dance, ROBOT.nominal_posture.copy()
        self.seen: list[FloatArray] = []  # measured, error, commanded positions of each period
        self.stand_up()
        assert not any(map(self.ask, path))

    def freeze(self, *limbs: str, behavior: str = "freeze") -> BehaviorReply:
        """Ask to freeze limbs."""
        return self._behaviors.handle(BehaviorRequest(behavior, list(limbs)), "somebody")

    def setpoint(self, limb: str, velocity: float = 0.0) -> JointSetpoints:
        """Set-points of a limb at its place in the dance, with one velocity [rad/s]."""
        position, ones = self.wanted[JOINTS[limb]], np.ones(len(JOINTS[limb]))
        return JointSetpoints(self.manager.time, ROBOT.tables.groups[limb], position, velocity * ones, 0.0 * ones)

    def _dance(self) -> None:
        now, phase = self.manager.time, 2.0 * self.time
        self._velocities.handle(Received(VelocityCommand(now, 0.3, 0.0, 0.0), 0, 1, "walker"), now)
        for limb, joints in JOINTS.items():
            self.wanted[joints] = ROBOT.nominal_posture[joints] + 0.15 * (1.0 - np.cos(phase))
            self.setpoints.handle(Received(self.setpoint(limb, 0.3 * np.sin(phase)), 0, 1, limb), now)
        position = self.plant.joint_position
        self.seen.append(np.array((position, np.abs(position - self.wanted), self.motor.position)))

    def watch(self, seconds: float) -> FloatArray:
        """(periods, 3, n) of ``seen``."""
        self.seen.clear()
        self.run(seconds)
        return np.array(self.seen)
