"""Why a trajectory is not obeyed."""

from __future__ import annotations

from enum import IntEnum


class ErrorCode(IntEnum):
    """As ``control_msgs/action/FollowJointTrajectory`` numbers them."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class InvalidTrajectoryError(ValueError):
    """A trajectory that is not obeyed: its text names the joint, the value and the limit."""

    def __init__(self, text: str, code: ErrorCode = ErrorCode.INVALID_GOAL) -> None:
        super().__init__(text)
        self.code = code
