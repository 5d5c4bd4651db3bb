"""``motion_manager/hand_goal``: Cartesian goals of the hands, in the manipulate behaviors."""

from __future__ import annotations

from typing import Self

import numpy as np

from bifrost import Received
from valor.common.behaviors import Manipulation
from valor.common.errors import RefusalError
from valor.common.messages import HandGoal as HandGoalMessage
from valor.common.rotation import NORM
from valor.common.topics import HAND_GOAL
from valor.motion_manager.handlers.handler import Handler, pose, require_fresh
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.hands.hand_goals import SIDES, HandGoals
from valor.motion_manager.hands.led_arm import HandGoal
from valor.motion_manager.parts import Parts
from valor.motion_manager.states.behavior_fsm import BehaviorFsm

FRAMES = ("pelvis", "odom")
FARTHEST = 10.0  # from a frame's origin that a goal is looked at at all [m]


class HandGoalHandler(Handler[HandGoalMessage]):
    """Checks goals and hands them on."""

    topic = HAND_GOAL

    def __init__(self, fsm: BehaviorFsm, goals: HandGoals, rejections: Rejections) -> None:
        super().__init__(rejections)
        self._fsm = fsm
        self._goals = goals

    @classmethod
    def of(cls, parts: Parts) -> Self:
        """The one of a Motion Manager."""
        return cls(parts.fsm, parts.hand_goals, parts.rejections)

    def obey(self, received: Received[HandGoalMessage], now: int) -> None:
        """Lead a hand, or let it go."""
        message = received.message
        if message.hand not in (0, 1):
            raise RefusalError("hand", f"hand {message.hand}; expected 0 (left) or 1 (right)")
        if message.hand not in self._goals.sides:
            raise RefusalError("hand", f"this robot has no {SIDES[message.hand]} hand on an arm")
        if not message.active:
            self._goals.release(message.hand, f"let go by {received.origin}")
            return
        self._goals.lead(message.hand, self._goal(message, now), 1e-9 * now)

    def _goal(self, message: HandGoalMessage, now: int) -> HandGoal:
        if self._fsm.manipulation is not Manipulation.TELEOP:
            raise RefusalError("behavior", f"hands are led in the manipulate behaviors; it is {self._fsm.behavior}")
        if message.frame not in FRAMES:
            raise RefusalError("frame", f"frame {message.frame[:64]!r}; expected {' or '.join(FRAMES)}")
        position, matrix = pose(message.position, message.orientation, NORM)
        if np.abs(position).max() > FARTHEST:
            raise RefusalError("number", f"position {position.tolist()} is farther than {FARTHEST:g} m away")
        require_fresh(message.time, now)
        return HandGoal(message.frame == "odom", position, matrix)
