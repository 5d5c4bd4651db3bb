"""``motion_manager/velocity``: walking velocities, followed where the Locomotion FSM walks."""

from __future__ import annotations

import numpy as np

from bifrost import Received
from valor.common.behaviors import Locomotion
from valor.common.messages import VelocityCommand
from valor.common.topics import VELOCITY
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.motion_manager.whole_body.walking.velocity_steps import VelocitySteps

STALE = 0.5  # a velocity for a state older than this is refused [s of robot time]


class VelocityHandler:
    """Checks velocities and hands them to the steps on line, which clamp them to what the robot can do."""

    def __init__(self, fsm: BehaviorFsm, steps: VelocitySteps, rejections: Rejections) -> None:
        self._fsm = fsm
        self._steps = steps
        self._rejections = rejections

    def handle(self, received: Received[VelocityCommand], now: int) -> bool:
        """Follow a velocity or refuse it, at robot time ``now`` [ns]; returns whether it is followed."""
        message = received.message
        velocity = np.array((message.linear_x, message.linear_y, message.angular_z))
        age = 1e-9 * (now - message.time)
        if self._fsm.locomotion is not Locomotion.WALK:
            kind = "behavior"
            reason = f"velocities are followed in behaviors walk and walk_manipulate; it is {self._fsm.behavior}"
        elif not np.isfinite(velocity).all():
            kind, reason = "number", f"velocity {velocity.tolist()} is not finite"
        elif abs(age) > STALE:
            kind, reason = "stale", f"made for a state {age:.3f} s old; expected at most {STALE} s"
        else:
            self._steps.command(velocity, 1e-9 * now)
            return True
        self._rejections.add(VELOCITY.name, received.origin, kind, reason)
        return False
