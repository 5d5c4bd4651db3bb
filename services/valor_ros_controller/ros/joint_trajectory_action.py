"""The ROS face of a joint trajectory controller: action, topics, state."""

from __future__ import annotations

import array
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTrajectoryControllerState
from rclpy.action import CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from valor_ros_controller.controllers.joint_trajectory_controller import (
    Goal,
    JointTrajectoryController,
    Outcome,
    TrajectoryRequest,
    Vector,
)
from valor_ros_controller.ros.deferred_action_server import DeferredActionServer
from valor_ros_controller.trajectory import ErrorCode, InvalidTrajectoryError, Point, check_waypoints
from valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface


def _nanoseconds(time: Any) -> int:
    """Of a Time or a Duration."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def _numbers(values: Vector) -> array.array[float]:
    """What rclpy's setters take without looking at each element."""
    return array.array("d", values.tobytes())


def _point(position: Vector, velocity: Vector, acceleration: Vector | None = None) -> Any:
    point = JointTrajectoryPoint(positions=_numbers(position), velocities=_numbers(velocity))
    if acceleration is not None:
        point.accelerations = _numbers(acceleration)
    return point


class _TrajectoryGoal:
    """A goal of the action."""

    def __init__(self, face: JointTrajectoryAction, handle: ServerGoalHandle) -> None:
        self._face = face
        self._handle = handle

    def finish(self, outcome: Outcome) -> None:
        ended = "succeed" if outcome.code is ErrorCode.SUCCESSFUL else "abort"
        state = "canceled" if outcome.canceled else ended
        result = FollowJointTrajectory.Result(error_code=int(outcome.code), error_string=outcome.text)
        self._face.forget(self._handle)
        self._face.server.finish(self._handle, state, result)

    def feedback(self, controller: JointTrajectoryController, hw: ValorEscherHWInterface) -> None:
        feedback = FollowJointTrajectory.Feedback()
        self._face.fill(feedback, "desired", "actual", hw)
        self._handle.publish_feedback(feedback)


class JointTrajectoryAction:
    """Trajectories of one controller on ROS.

    Attributes:
        server: the action server.
    """

    def __init__(self, node: Node, namespace: str, controller: JointTrajectoryController, stamp: Time) -> None:
        """Open the interfaces under ``<namespace>/<controller>``.

        Args:
            node: the ROS node.
            namespace: absolute.
            controller: runs the trajectories.
            stamp: robot time, kept up to date by its owner.
        """
        base = f"{namespace}/{controller.name}"
        self._controller = controller
        self._stamp = stamp
        self._names = list(controller.limits.names)
        self._goals: dict[bytes, Goal] = {}
        self._state_period = round(1e9 / controller.config.action_monitor_rate)
        self._next_state = 0
        self._state = node.create_publisher(JointTrajectoryControllerState, f"{base}/controller_state", 1)
        self.server = DeferredActionServer(
            node, FollowJointTrajectory, f"{base}/follow_joint_trajectory", self._goal, self._cancel
        )
        node.create_subscription(JointTrajectory, f"{base}/joint_trajectory", self._command, 1)
        node.create_subscription(JointTrajectory, f"{base}/command", self._command, 1)

    # --- update thread --------------------------------------------------------------------------------------------

    def fill(self, message: Any, desired: str, actual: str, hw: ValorEscherHWInterface) -> None:
        """Write stamp, names, desired state, actual state and error into a message."""
        controller = self._controller
        position, velocity = hw.position[controller.joints], hw.velocity[controller.joints]
        message.header.stamp = self._stamp
        message.joint_names = self._names
        setattr(message, desired, _point(controller.position, controller.velocity, controller.acceleration))
        setattr(message, actual, _point(position, velocity))
        message.error = _point(controller.position - position, controller.velocity - velocity)

    def publish(self, hw: ValorEscherHWInterface) -> None:
        """Publish ``controller_state`` while the controller is active, at its monitor rate."""
        if not self._controller.active or self._next_state - self._state_period <= hw.time < self._next_state:
            return
        self._next_state = hw.time + self._state_period
        message = JointTrajectoryControllerState(speed_scaling_factor=1.0)
        self.fill(message, "reference", "feedback", hw)
        message.output = message.reference
        self._state.publish(message)

    # --- ROS thread -----------------------------------------------------------------------------------------------

    def forget(self, handle: ServerGoalHandle) -> None:
        """A goal has ended. From any thread."""
        self._goals.pop(bytes(handle.goal_id.uuid), None)

    def _goal(self, handle: ServerGoalHandle) -> None:
        goal = _TrajectoryGoal(self, handle)
        self._goals[bytes(handle.goal_id.uuid)] = goal
        request = handle.request
        try:
            multi = request.multi_dof_trajectory
            if multi.joint_names or multi.points or request.component_path_tolerance:
                raise InvalidTrajectoryError(
                    ErrorCode.INVALID_GOAL, "joints with several degrees of freedom: this controller has none"
                )
            self._controller.submit(self._request(request.trajectory, request, goal))
        except InvalidTrajectoryError as error:
            self._controller.refuse(goal, error)

    def _cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        goal = self._goals.get(bytes(handle.goal_id.uuid))
        if goal is None:
            return CancelResponse.REJECT
        self._controller.cancel(goal)
        return CancelResponse.ACCEPT

    def _command(self, message: Any) -> None:
        try:
            self._controller.submit(self._request(message, None, None))
        except InvalidTrajectoryError as error:
            self._controller.refuse(None, error)

    def _request(self, trajectory: Any, goal: Any, client: Goal | None) -> TrajectoryRequest:
        """Check what came.

        Raises:
            InvalidTrajectoryError: it is not to be run.
        """
        controller = self._controller
        points = [
            Point(p.positions, p.velocities, p.accelerations, p.effort, _nanoseconds(p.time_from_start) * 1e-9)
            for p in trajectory.points
        ]
        waypoints = check_waypoints(
            list(trajectory.joint_names),
            points,
            controller.limits,
            allow_partial=controller.config.allow_partial_joints_goal,
        )
        path, at_goal = controller.path, controller.goal_tolerance
        goal_time = controller.config.constraints.goal_time
        if goal is not None:
            for which, entries in (("path_tolerance", goal.path_tolerance), ("goal_tolerance", goal.goal_tolerance)):
                overrides = [(entry.name, entry.position, entry.velocity) for entry in entries]
                if which == "path_tolerance":
                    path = path.override(overrides, controller.limits.names, which)
                else:
                    at_goal = at_goal.override(overrides, controller.limits.names, which)
            stated = _nanoseconds(goal.goal_time_tolerance) * 1e-9
            if stated < 0 and not np.isclose(stated, -1.0):
                raise InvalidTrajectoryError(
                    ErrorCode.INVALID_GOAL,
                    f"goal_time_tolerance is {stated:g} s; expected 0 or more, or -1 (unchecked)",
                )
            if stated:
                goal_time = max(0.0, stated)
        return TrajectoryRequest(waypoints, _nanoseconds(trajectory.header.stamp), path, at_goal, goal_time, client)
