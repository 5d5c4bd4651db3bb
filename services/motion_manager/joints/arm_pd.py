"""PD control of the arms as in the thesis (5.3.1), without compensation of weight, friction and play.

A PD controller on the measured joints q determines the motors' set-points from the Whole-Body Controller's, q* and q̇*:

    velocity = q̇* + gain·(q* − q) + damping·(q̇* − q̇)
    position = q + horizon·(velocity − q̇*)
    effort   = 0

A joint that carries τ rests at q* − τ/k, with ``ArmPd.stiffness`` k; its motor's position set-point is off by a part of
that. A joint that does not move gets a constant velocity.
"""

import numpy as np

from valor.common.arrays import FloatArray
from valor.control.controller import JointCommand
from valor.control.motor_command import MotorCommand
from valor.control.state import RobotState
from valor.robot.description import RobotDescription


class ArmPdControl:
    """PD control of the joints of both arms, while the Whole-Body Controller moves them."""

    def __init__(self, robot: RobotDescription, motors: MotorCommand) -> None:
        indices = np.concatenate([np.zeros(0, dtype=np.intp), *robot.arms()])
        self.joints = indices[~motors.force[indices]]  # (m,) their indices in every joint vector
        self._gains = robot.tables.arm_pd
        self._fastest = robot.velocity_limit[self.joints]
        self._offsets = np.zeros(len(robot.joints))

    def apply(self, state: RobotState, command: JointCommand) -> FloatArray:
        """Replace the arms' velocity and effort in a command; returns (n,) position set-points minus its own [rad]."""
        joints, gains = self.joints, self._gains
        position, rate = state.joint_position[joints], command.velocity[joints]
        asked = rate + gains.gain * (command.position[joints] - position)
        asked += gains.damping * (rate - state.joint_velocity[joints])
        command.velocity[joints] = velocity = np.clip(asked, -self._fastest, self._fastest)
        command.effort[joints] = 0.0
        self._offsets[joints] = position + gains.horizon * (velocity - rate) - command.position[joints]
        return self._offsets
