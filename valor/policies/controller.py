"""A policy as a controller of the balancing robot."""

from __future__ import annotations

import numpy as np

from valor.common.behaviors import Locomotion
from valor.control.controller import Controller, JointCommand, Request
from valor.control.state import RobotState
from valor.policies.observations import Senses
from valor.policies.policy import Policy
from valor.robot.description import RobotDescription

STILL = 0.05  # speed of the CoM at rest [m/s]
FASTEST_CHANGE = 1.0, 2.0  # of the velocity command: linear [m/s²], turning [rad/s²]


class PolicyController(Controller):
    """Walks at a velocity, and stands if it is zero; commands the policy's joints."""

    states = frozenset({Locomotion.STAND, Locomotion.WALK})
    steps_to_balance = True

    def __init__(self, policy: Policy, robot: RobotDescription) -> None:
        """Create the controller of a policy, whose contract is one for this robot."""
        contract = policy.contract
        self.name = contract.name
        self._policy, self._zeros = policy, np.zeros(len(robot.joints))
        self.joints = np.zeros(len(robot.joints), dtype=bool)
        self.joints[policy.indices] = True
        self.period = round(contract.period / robot.control_period)
        self.warm_up = contract.period * max((term.history for term in contract.observation), default=1)
        rates = FASTEST_CHANGE[0], FASTEST_CHANGE[0], FASTEST_CHANGE[1]
        self._change = contract.period * np.array(rates)
        self._velocity = np.zeros(3)
        self._rests = True

    @property
    def at_rest(self) -> bool:
        """True if it is to stand, and does."""
        return self._rests

    def begin(self, state: RobotState, last: JointCommand | None) -> None:
        """Forget the past; the first command is to stand."""
        self._policy.reset()
        self._velocity = np.zeros(3)

    def update(self, state: RobotState, request: Request, dt: float) -> JointCommand:
        """Let the policy act."""
        asked = request.velocity if request.locomotion is Locomotion.WALK else np.zeros(3)
        self._velocity = np.clip(asked, self._velocity - self._change, self._velocity + self._change)
        self._rests = bool(state.com_speed < STILL and state.contacts.all() and not self._velocity.any())
        turn = state.pelvis_rotation_in_odom
        targets = self._policy.act(
            Senses(
                state.joint_position,
                state.joint_velocity,
                state.pelvis_orientation_in_odom,
                state.pelvis_angular_velocity_in_pelvis,
                turn.T @ state.pelvis_linear_velocity_in_odom,
                self._velocity,
            )
        )
        joints = self._policy.indices
        command = JointCommand(*(self._zeros.copy() for _ in range(5)))
        command.position[joints], command.stiffness[joints] = targets.position, targets.stiffness
        command.damping[joints] = targets.damping
        if targets.velocity is not None:
            command.velocity[joints] = targets.velocity
        if targets.effort is not None:
            command.effort[joints] = targets.effort
        return command
