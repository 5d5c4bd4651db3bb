"""Set-points of walking velocity, pelvis and hands."""

import numpy as np

from bifrost import Received
from valor.common.behaviors import Locomotion, Manipulation
from valor.common.errors import RefusalError
from valor.common.messages import HandGoal as HandGoalMessage
from valor.common.messages import PelvisSetpoint, VelocityCommand
from valor.common.rotation import NORM
from valor.common.topics import HAND_GOAL, PELVIS, VELOCITY
from valor.motion_manager.handlers.handler import Handler, pose, require_finite, require_fresh
from valor.motion_manager.hands.goal_stream import HandGoal
from valor.motion_manager.hands.hand_goals import SIDES
from valor.whole_body.balance.pelvis import HEIGHT


class VelocityHandler(Handler[VelocityCommand]):
    """Checks velocities and forwards them to the step generator, which clamps them to the robot's limits."""

    topic = VELOCITY

    def execute(self, received: Received[VelocityCommand], now: int) -> None:
        message, fsm = received.message, self.components.fsm
        velocity = np.array((message.linear_x, message.linear_y, message.angular_z))
        if fsm.locomotion is not Locomotion.WALK:
            raise RefusalError(
                "behavior", f"velocities are followed in behaviors walk and walk_manipulate; it is {fsm.behavior}"
            )
        require_finite("velocity", velocity)
        require_fresh(message.time, now)
        self.components.velocity_steps.command(velocity, 1e-9 * now)


class PelvisHandler(Handler[PelvisSetpoint]):
    """Checks set-points, clamps them to the limits of robot.yaml and forwards them to the pelvis reference."""

    topic = PELVIS

    def execute(self, received: Received[PelvisSetpoint], now: int) -> None:
        message, pelvis = received.message, self.components.whole_body.pelvis
        self._check(message, now)
        limits = pelvis.limits
        position, velocity = limits.position_within(message.position), limits.velocity_within(message.velocity)
        pelvis.lead(position, velocity, 1e-9 * message.time)

    def _check(self, message: PelvisSetpoint, now: int) -> None:
        behavior, locomotion = self.components.fsm.behavior, self.components.fsm.locomotion
        if locomotion is not Locomotion.STAND and not locomotion.stepping:
            raise RefusalError(
                "behavior", f"pelvis set-points are followed while the robot stands or steps; it is in {behavior}"
            )
        for what, vector in (("position", message.position), ("velocity", message.velocity)):
            if vector.shape != (6,):
                raise RefusalError("length", f"{what} has {vector.size} numbers; expected 6: x, y, z, roll, pitch, yaw")
            require_finite(what, vector)
        require_fresh(message.time, now)
        if locomotion.stepping and np.abs(np.delete(message.position, HEIGHT)).max() > 0.0:
            raise RefusalError("stepping", f"in {behavior} only the pelvis' height is followed; expected other zeros")


FRAMES = ("pelvis", "odom")
FARTHEST = 10.0  # largest coordinate of a goal [m]


class HandGoalHandler(Handler[HandGoalMessage]):
    """Checks goals and forwards them."""

    topic = HAND_GOAL

    def execute(self, received: Received[HandGoalMessage], now: int) -> None:
        message, goals = received.message, self.components.hand_goals
        if message.hand not in (0, 1):
            raise RefusalError("hand", f"hand {message.hand}; expected 0 (left) or 1 (right)")
        if message.hand not in goals.sides:
            raise RefusalError("hand", f"this robot has no {SIDES[message.hand]} hand on an arm")
        if not message.active:
            goals.release(message.hand, f"released by {received.origin}")
            return
        goals.start(message.hand, self._goal(message, now), 1e-9 * now)

    def _goal(self, message: HandGoalMessage, now: int) -> HandGoal:
        fsm = self.components.fsm
        if fsm.manipulation is not Manipulation.TELEOP:
            raise RefusalError("behavior", f"hand goals are followed in the manipulate behaviors; it is {fsm.behavior}")
        if (arm := f"{SIDES[message.hand]}_arm") in self.components.upper_body.frozen:
            raise RefusalError("frozen", f"{arm} is frozen")
        if message.frame not in FRAMES:
            raise RefusalError("frame", f"frame {message.frame[:64]!r}; expected {' or '.join(FRAMES)}")
        position, matrix = pose(message.position, message.orientation, NORM)
        if np.abs(position).max() > FARTHEST:
            raise RefusalError("number", f"position {position.tolist()} is farther than {FARTHEST:g} m away")
        require_fresh(message.time, now)
        return HandGoal(message.frame == "odom", position, matrix)
