"""A robot that stands quite still, and a Motion Manager in one process that answers what its devices say."""

from __future__ import annotations

from typing import Any

import numpy as np

from bifrost import Message
from harness.places import ROBOTS
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.common.messages import BehaviorRequest, JointMode, Motor, Proprioceptor
from valor.motion_manager.handlers.behavior import BehaviorHandler
from valor.motion_manager.manager import MotionManager
from valor.robot.description import RobotDescription
from valor.robot.model import controller_model

ROBOT = RobotDescription.load(ROBOTS / "escher")
MODEL = controller_model(ROBOT)
N = len(ROBOT.joints)
PERIOD = round(1e9 * ROBOT.control_period)
WEIGHT = float(MODEL.mj.body_subtreemass[0]) * 9.81
LIMIT = ROBOT.effort_limit


def tilted(angle: float) -> FloatArray:
    """Attitude of a pelvis that has turned forwards [rad]."""
    return np.array([np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0])


class Robot:
    """What the devices of a robot say that stands quite still, and a Motion Manager that answers."""

    def __init__(self) -> None:
        self.manager = MotionManager(ROBOT, MODEL)
        self.time, self.sequence = 0, 0
        self.motor: Motor | None = None

    def proprioceptor(self, **changes: object) -> Proprioceptor:
        foot = np.array([0.0, 0.0, 0.5 * WEIGHT, 0.0, -0.02 * 0.5 * WEIGHT, 0.0])
        values: dict[str, object] = {
            "time": self.time, "sequence": self.sequence, "motor_sequence": 0,
            "joint_position": ROBOT.nominal_posture.copy(), "joint_velocity": np.zeros(N), "joint_effort": np.zeros(N),
            "imu_orientation": tilted(0.0), "imu_angular_velocity": np.zeros(3),
            "imu_linear_acceleration": np.array([0.0, 0.0, 9.81]),
            "kvh_angular_velocity": np.zeros(0), "kvh_linear_acceleration": np.zeros(0),
            "left_foot_wrench": foot, "right_foot_wrench": foot.copy(),
            "left_hand_wrench": np.zeros(6), "right_hand_wrench": np.zeros(6), "battery_voltage": 48.0,
            "motor_behavior": "",
        }  # fmt: skip
        return Proprioceptor(**(values | changes))  # type: ignore[arg-type]

    def tick(self, elapsed: int = PERIOD, **changes: object) -> Motor:
        """One period of robot time, what the devices say, and the Motor that answers."""
        self.time += elapsed
        self.sequence += elapsed // PERIOD
        said = self.proprioceptor(**changes)
        before = 0 if self.motor is None else self.motor.sequence
        self.motor = self.manager.tick(said)
        assert self.motor.proprioceptor_sequence == said.sequence
        assert self.motor.sequence == before + 1
        assert self.motor.time == said.time
        self.check(self.motor)
        self.report()
        return self.motor

    @staticmethod
    def check(motor: Motor) -> None:
        for vector in (motor.position, motor.velocity, motor.effort, motor.stiffness, motor.damping):
            assert vector.shape == (N,)
            assert np.isfinite(vector).all()
        assert (np.abs(motor.effort) <= LIMIT).all()
        assert (motor.position >= ROBOT.lower).all() and (motor.position <= ROBOT.upper).all()
        assert motor.mode.shape == (N,)

    def report(self) -> Message:
        report = self.manager.report(1e-3)
        assert report.proprioceptor_sequence == self.sequence
        return report

    def run(self, seconds: float, **changes: Any) -> None:
        for _ in range(round(seconds / ROBOT.control_period)):
            self.tick(**changes)

    def stand(self) -> Robot:
        """From its beginning; returns it."""
        self.run(1.0)
        assert not self.ask(Behavior.STAND)
        self.run(0.5)
        assert self.behavior is Behavior.STAND
        return self

    @property
    def behavior(self) -> Behavior:
        return self.manager.fsm.behavior

    def ask(self, behavior: Behavior) -> str:
        """Request a behavior; returns the reason of a refusal."""
        reply = BehaviorHandler(self.manager.components).handle(BehaviorRequest(behavior=behavior), "somebody")
        assert reply.accepted or reply.reason
        return "" if reply.accepted else reply.reason

    def torque(self) -> FloatArray:
        """What each joint's motor gives now, the joints standing where they stand."""
        motor = self.motor
        assert motor is not None
        error = motor.position - ROBOT.nominal_posture
        torque = motor.effort + (motor.mode != JointMode.FORCE) * (motor.stiffness * error)
        return np.where(motor.mode == JointMode.OFF, 0.0, torque)
