"""The ROS face of a tracking controller: an action that says why it takes no goals."""

from __future__ import annotations

import logging

from control_msgs.action import FollowJointTrajectory
from rclpy.action import CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node

from valor.valor_ros_controller.controllers.tracking_controller import TrackingController
from valor.valor_ros_controller.ros.deferred_action_server import DeferredActionServer

_log = logging.getLogger("tracking_controller")


class TrackingAction:
    """Goals for joints that are not led from outside.

    Attributes:
        server: the action server.
    """

    def __init__(self, node: Node, base: str, controller: TrackingController) -> None:
        """Open the action under ``base``."""
        self._controller = controller
        self.server = DeferredActionServer(
            node, FollowJointTrajectory, f"{base}/follow_joint_trajectory", self._goal, self._cancel
        )

    def _goal(self, handle: ServerGoalHandle) -> None:
        text = self._controller.refusal
        _log.warning("%s", text)
        result = FollowJointTrajectory.Result(error_code=FollowJointTrajectory.Result.INVALID_GOAL, error_string=text)
        self.server.finish(handle, "abort", result)

    @staticmethod
    def _cancel(_: ServerGoalHandle) -> CancelResponse:
        return CancelResponse.REJECT
