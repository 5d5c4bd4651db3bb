"""``/robot_controllers/footstep_controller/controller_state``: what the Motion System says of its steps.

The type is that of ViGIR's step controller, whose actions' feedback messages were topics' types too. Feedback of a plan
comes from the Footstep Converter, which knows the plan; this is there without one, too.
"""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus

from valor.common.messages import StepStatus
from valor.valor_ros_controller.controllers.footstep_controller import FootstepController, State
from valor.valor_ros_controller.ros.node import LATCHED

TOPIC = "robot_controllers/footstep_controller/controller_state"
FEEDBACK_MESSAGE = ExecuteStepPlan.Impl.FeedbackMessage  # the one of an action's types that is imported by its name
_STEPPING = {
    State.READY: FootstepExecutionStatus.NO_ERROR,
    State.ACTIVE: FootstepExecutionStatus.EXECUTING_STEP_PLAN,
    State.FINISHED: FootstepExecutionStatus.REACHED_GOAL,
    State.FAILED: FootstepExecutionStatus.PREMATURE_HALT,
}


class FootstepStatePublisher:
    """Publishes on change."""

    def __init__(self, node: Node, controller: FootstepController, stamp: Time, frame: str) -> None:
        """Open the topic.

        Args:
            node: the ROS node.
            controller: is published of.
            stamp: robot time, kept up to date by its owner.
            frame: odom, as tf names it.
        """
        self._controller, self._frame = controller, frame
        self._stamp = stamp
        self._publisher = node.create_publisher(FEEDBACK_MESSAGE, TOPIC, LATCHED)
        self._published: tuple[Any, ...] | None = None

    def publish(self) -> None:
        """Publish what is new."""
        status, state = self._controller.status, self._controller.state
        if self._published is not None and status is self._published[0] and state is self._published[1]:
            return
        self._published = (status, state)
        self._publisher.publish(FEEDBACK_MESSAGE(feedback=self._message(status, state)))

    def _message(self, status: StepStatus | None, state: State) -> Any:
        message = ExecuteStepPlan.Feedback(controller_state=int(state))
        message.header.stamp = Time(sec=self._stamp.sec, nanosec=self._stamp.nanosec)
        message.header.frame_id = self._frame
        if status is None:
            message.stepping_status = int(FootstepExecutionStatus.ERR_CONTROLLER_NOT_READY)
            message.first_queued_step_index = message.last_queued_step_index = -1
            message.last_performed_step_index = message.currently_executing_step_index = -1
            message.first_changeable_step_index = -1
            return message
        first = status.first_changeable_step_index
        message.stepping_status = int(_STEPPING[state])
        message.status.error_msg = status.reason
        message.queue_size = status.queue_size
        message.first_queued_step_index = message.first_changeable_step_index = first
        message.last_queued_step_index = first + status.queue_size - 1 if status.queue_size else -1
        message.last_performed_step_index = status.last_performed_step_index
        message.currently_executing_step_index = status.executing_step_index
        return message
