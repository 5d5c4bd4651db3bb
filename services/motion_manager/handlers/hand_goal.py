"""``motion_manager/hand_goal``: Cartesian goals of the hands, in the manipulate behaviors."""

from __future__ import annotations

import numpy as np

from bifrost import Received
from valor.common import rotation
from valor.common.behaviors import Manipulation
from valor.common.messages import HandGoal as HandGoalMessage
from valor.common.topics import HAND_GOAL
from valor.motion_manager.handlers.joint_setpoints import STALE
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.hands.hand_goals import SIDES, HandGoal, HandGoals
from valor.motion_manager.states.behavior_fsm import BehaviorFsm

FRAMES = ("pelvis", "odom")
FARTHEST = 10.0  # from a frame's origin that a goal is looked at at all [m]


class HandGoalHandler:
    """Checks goals and hands them on; ends them where the arms are not to be led from outside."""

    def __init__(self, fsm: BehaviorFsm, goals: HandGoals, rejections: Rejections) -> None:
        self._fsm = fsm
        self._goals = goals
        self._rejections = rejections

    def handle(self, received: Received[HandGoalMessage], now: int) -> bool:
        """Obey a goal or refuse it, at robot time ``now`` [ns]; returns whether it is obeyed."""
        message = received.message
        if fault := self._fault(message, now):
            self._rejections.add(HAND_GOAL.name, received.origin, *fault)
            return False
        if not message.active:
            self._goals.release(message.hand, f"let go by {received.origin}")
            return True
        matrix = np.empty((3, 3))
        rotation.matrix(rotation.quaternion(message.orientation), matrix)
        goal = HandGoal(message.frame == "odom", message.position.copy(), matrix)
        self._goals.lead(message.hand, goal, 1e-9 * now)
        return True

    def update(self) -> None:
        """End the goals when the arms close."""
        if self._goals.active and self._fsm.manipulation is not Manipulation.TELEOP:
            for side in range(len(SIDES)):
                self._goals.release(side, f"the behavior is {self._fsm.behavior}")

    def _fault(self, message: HandGoalMessage, now: int) -> tuple[str, str] | None:
        """What kind of fault a message has, and the reason for a person."""
        if message.hand not in (0, 1):
            return "hand", f"hand {message.hand}; expected 0 (left) or 1 (right)"
        if not message.active:
            return None
        if self._fsm.manipulation is not Manipulation.TELEOP:
            return "behavior", f"hands are led in the manipulate behaviors; it is {self._fsm.behavior}"
        if message.frame not in FRAMES:
            return "frame", f"frame {message.frame[:64]!r}; expected {' or '.join(FRAMES)}"
        position, orientation = message.position, message.orientation
        if position.shape != (3,) or orientation.shape != (4,):
            return "length", f"position and orientation have {position.size} and {orientation.size} numbers"
        if not (np.isfinite(position).all() and np.isfinite(orientation).all()):
            return "number", "position or orientation is not finite"
        if abs(float(np.linalg.norm(orientation)) - 1.0) > rotation.NORM:
            return "number", "the orientation is no unit quaternion"
        if np.abs(position).max() > FARTHEST:
            return "number", f"position {position.tolist()} is farther than {FARTHEST:g} m away"
        age = 1e-9 * (now - message.time)
        if abs(age) > STALE:
            return "stale", f"made for a state {age:.3f} s old; expected at most {STALE} s"
        return None
