"""``motion_manager/velocity``: walking velocities, followed where the Locomotion FSM walks."""

from __future__ import annotations

from typing import Self

import numpy as np

from bifrost import Received
from valor.common.behaviors import Locomotion
from valor.common.errors import RefusalError
from valor.common.messages import VelocityCommand
from valor.common.topics import VELOCITY
from valor.motion_manager.handlers.handler import Handler, require_finite, require_fresh
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.parts import Parts
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.whole_body.walking.velocity_steps import VelocitySteps


class VelocityHandler(Handler[VelocityCommand]):
    """Checks velocities and hands them to the steps on line, which clamp them to what the robot can do."""

    topic = VELOCITY

    def __init__(self, fsm: BehaviorFsm, steps: VelocitySteps, rejections: Rejections) -> None:
        super().__init__(rejections)
        self._fsm = fsm
        self._steps = steps

    @classmethod
    def of(cls, parts: Parts) -> Self:
        """The one of a Motion Manager."""
        return cls(parts.fsm, parts.velocity_steps, parts.rejections)

    def obey(self, received: Received[VelocityCommand], now: int) -> None:
        """Walk so."""
        message = received.message
        velocity = np.array((message.linear_x, message.linear_y, message.angular_z))
        if self._fsm.locomotion is not Locomotion.WALK:
            raise RefusalError(
                "behavior", f"velocities are followed in behaviors walk and walk_manipulate; it is {self._fsm.behavior}"
            )
        require_finite("velocity", velocity)
        require_fresh(message.time, now)
        self._steps.command(velocity, 1e-9 * now)
