"""The ROS face of a tracking controller: an action that says why it takes no goals."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from control_msgs.action import FollowJointTrajectory
from rclpy.action import CancelResponse
from rclpy.action.server import ServerGoalHandle

from valor.ros.deferred_action_server import DeferredActionServer
from valor.ros.node import ProcessNode
from valor.valor_ros_controller.controllers.tracking_controller import TrackingController
from valor.valor_ros_controller.ros.joint_trajectory_action import serve

_log = logging.getLogger("tracking_controller")


class TrackingAction:
    """Goals for joints that are not led from outside."""

    def __init__(self, node: ProcessNode, bases: Sequence[str], controller: TrackingController) -> None:
        """Open the action under each of ``bases``."""
        self._controller = controller
        for base in bases:
            serve(node, base, self._goal, self._cancel)

    def _goal(self, server: DeferredActionServer, handle: ServerGoalHandle) -> None:
        text = self._controller.refusal
        _log.warning("%s", text)
        result = FollowJointTrajectory.Result(error_code=FollowJointTrajectory.Result.INVALID_GOAL, error_string=text)
        server.finish(handle, "abort", result)

    @staticmethod
    def _cancel(_: ServerGoalHandle) -> CancelResponse:
        return CancelResponse.REJECT
