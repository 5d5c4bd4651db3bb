"""ROS interfaces of the control mode controller: ViGIR's action, command topic and reports."""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time
from rclpy.action import CancelResponse
from rclpy.action.server import ServerGoalHandle
from std_msgs.msg import String
from vigir_humanoid_control_msgs.action import ChangeControlMode
from vigir_humanoid_control_msgs.msg import ControlModeStatus, VigirControlModeCommand

from valor.common.messages import ModeStatus
from valor.ros.deferred_action_server import DeferredActionServer
from valor.ros.node import ProcessNode
from valor.valor_ros_controller.control_modes import ModeReport
from valor.valor_ros_controller.controllers.control_mode_controller import ControlModeController
from valor.valor_ros_controller.ros.node import LATCHED

ACTION = "mode_controllers/control_mode_controller/change_control_mode"
COMMAND = "flor/controller/mode_command"
REPORT = "flor/controller/mode"
NAME = "flor/controller/mode_name"
REPORT_PERIOD = 1_000_000_000  # of unchanged reports [ns of robot time]


class _ModeGoal:
    def __init__(self, action: ControlModeAction, handle: ServerGoalHandle) -> None:
        self._action, self._handle = action, handle

    def processing(self, report: ModeReport) -> None:
        self._handle.publish_feedback(ChangeControlMode.Feedback(feedback=self._action.message(report)))

    def finish(self, report: ModeReport) -> None:
        state = "succeed" if report.status & ModeStatus.MODE_ACCEPTED else "abort"
        result = ChangeControlMode.Result(result=self._action.message(report))
        self._action.server.finish(self._handle, state, result)


class ControlModeAction:
    """Control modes on ROS."""

    def __init__(self, node: ProcessNode, controller: ControlModeController, stamp: Time) -> None:
        """``stamp``: robot time, updated by its owner."""
        self._controller = controller
        self._stamp = stamp
        self._report = node.create_publisher(ControlModeStatus, REPORT, LATCHED)
        self._name = node.create_publisher(String, NAME, LATCHED)
        self._reports = 0
        self._mode = ""
        self._repeat_at = 0
        self.server = DeferredActionServer(
            node, ChangeControlMode, ACTION, self._goal, self._cancel, on_late=self._late if node.others else None
        )
        node.create_subscription(VigirControlModeCommand, COMMAND, self._command, 10)

    def message(self, report: ModeReport) -> Any:
        message = ControlModeStatus()
        message.header.stamp = Time(sec=self._stamp.sec, nanosec=self._stamp.nanosec)
        message.requested_control_mode = report.requested
        message.current_control_mode = report.current
        message.status = int(report.status)
        return message

    def publish(self, time: int) -> None:
        """Report on change and every ``REPORT_PERIOD``; ``time`` is robot time [ns]. Update thread."""
        if self._controller.reports == self._reports and time < self._repeat_at <= time + REPORT_PERIOD:
            return
        self._reports = self._controller.reports
        self._repeat_at = time + REPORT_PERIOD
        report = self._controller.report
        self._report.publish(self.message(report))
        if report.current != self._mode:
            self._mode = report.current
            self._name.publish(String(data=report.current))

    def _goal(self, handle: ServerGoalHandle) -> None:
        self._controller.request(handle.request.mode_request, _ModeGoal(self, handle))

    def _late(self, handle: ServerGoalHandle, _: str) -> None:
        current, status = self._controller.report.current, ModeStatus.MODE_REJECTED | ModeStatus.ERR_UNKNOWN
        _ModeGoal(self, handle).finish(ModeReport("", current, status))

    @staticmethod
    def _cancel(_: ServerGoalHandle) -> CancelResponse:
        # A started transition cannot be reverted; freeze and soft_stop preempt it.
        return CancelResponse.REJECT

    def _command(self, message: Any) -> None:
        self._controller.request(message.requested_control_mode)
