"""ROS interfaces of joint trajectory and tracking controllers: actions, topics, query, state."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTrajectoryControllerState
from control_msgs.srv import QueryTrajectoryState
from rclpy.action import CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from valor.common.arrays import FloatArray, sequence
from valor.ros.deferred_action_server import DeferredActionServer
from valor.ros.node import ProcessNode
from valor.valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController, Schedule
from valor.valor_ros_controller.controllers.tracking import TrackingController
from valor.valor_ros_controller.controllers.trajectory_goal import (
    TrajectoryGoal,
    TrajectoryOutcome,
    TrajectoryRequest,
    stated,
)
from valor.valor_ros_controller.core import UpdateQueue
from valor.valor_ros_controller.trajectory.admission import check_waypoints
from valor.valor_ros_controller.trajectory.waypoints import ErrorCode, InvalidTrajectoryError, Point
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

_log = logging.getLogger("tracking_controller")

Limb = JointTrajectoryController | TrackingController


def _nanoseconds(time: Any) -> int:
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def _point(state: Iterable[FloatArray], since_start: int = 0) -> Any:
    """Point of position, velocity and acceleration, as far as ``state`` has them; ``since_start``: [ns]."""
    point = JointTrajectoryPoint()
    for name, values in zip(("positions", "velocities", "accelerations"), state, strict=False):
        setattr(point, name, sequence(values))
    seconds, nanoseconds = divmod(since_start, 1_000_000_000)
    point.time_from_start = Duration(sec=seconds, nanosec=nanoseconds)
    return point


def _result(code: ErrorCode, text: str) -> Any:
    return FollowJointTrajectory.Result(error_code=int(code), error_string=text)


def _serve(
    node: ProcessNode,
    base: str,
    on_goal: Callable[[DeferredActionServer, ServerGoalHandle], None],
    on_cancel: Callable[[ServerGoalHandle], CancelResponse],
) -> None:
    """Serve ``follow_joint_trajectory`` under a name; ``on_goal`` receives the server that finishes the goal."""

    def late(handle: ServerGoalHandle, reason: str) -> None:
        server.finish(handle, "abort", _result(ErrorCode.OLD_HEADER_TIMESTAMP, reason))

    server = DeferredActionServer(
        node,
        FollowJointTrajectory,
        f"{base}/follow_joint_trajectory",
        lambda handle: on_goal(server, handle),
        on_cancel,
        on_late=late if node.others else None,
    )


class _ActionGoal:
    def __init__(self, action: JointTrajectoryAction, server: DeferredActionServer, handle: ServerGoalHandle) -> None:
        self._action, self._server, self._handle = action, server, handle

    def finish(self, outcome: TrajectoryOutcome) -> None:
        ended = "succeed" if outcome.code is ErrorCode.SUCCESSFUL else "abort"
        self._action.remove(self._handle)
        state = "canceled" if outcome.canceled else ended
        self._server.finish(self._handle, state, _result(outcome.code, outcome.text))

    def feedback(self, hw: ValorEscherHWInterface) -> None:
        self._handle.publish_feedback(self._action.feedback(hw))


class JointTrajectoryAction:
    """Trajectories of one controller, under several names."""

    def __init__(
        self,
        node: ProcessNode,
        bases: Sequence[str],
        controller: JointTrajectoryController,
        stamp: Time,
        queue: UpdateQueue,
        *,
        rejection: str = "",
    ) -> None:
        """Open the interfaces.

        ``bases``: prefixes of their names; the first, ViGIR's, also has the topic ``command``. ``stamp``: robot time,
        updated by its owner. ``rejection``: reason to reject every trajectory; empty if there is none.
        """
        self._rejection, self._controller, self._stamp, self._queue = rejection, controller, stamp, queue
        self._names = list(controller.limits.names)
        self._goals: dict[bytes, TrajectoryGoal] = {}
        self.topic = f"{bases[0]}/joint_trajectory"  # of trajectories without a goal
        node.create_subscription(JointTrajectory, f"{bases[0]}/command", self._command, 1)
        for base in bases:
            _serve(node, base, self._goal, self._cancel)
            node.create_subscription(JointTrajectory, f"{base}/joint_trajectory", self._command, 1)
            node.create_service(QueryTrajectoryState, f"{base}/query_state", self._query)

    # --- update thread --------------------------------------------------------------------------------------------

    def feedback(self, hw: ValorEscherHWInterface) -> Any:
        controller = self._controller
        desired = np.stack((controller.position, controller.velocity, controller.acceleration))
        actual = np.stack((hw.position[controller.joints], hw.velocity[controller.joints]))
        since = hw.time - controller.trajectory_start
        feedback = FollowJointTrajectory.Feedback(joint_names=self._names)
        feedback.header.stamp = self._stamp
        feedback.desired, feedback.actual = _point(desired, since), _point(actual, since)
        feedback.error = _point(desired[:2] - actual, since)
        return feedback

    # --- ROS thread -----------------------------------------------------------------------------------------------

    def remove(self, handle: ServerGoalHandle) -> None:
        """Remove a goal that has ended. From any thread."""
        self._goals.pop(bytes(handle.goal_id.uuid), None)

    def _goal(self, server: DeferredActionServer, handle: ServerGoalHandle) -> None:
        goal = _ActionGoal(self, server, handle)
        self._goals[bytes(handle.goal_id.uuid)] = goal
        request = handle.request
        try:
            multi = request.multi_dof_trajectory
            components = request.component_path_tolerance or request.component_goal_tolerance
            if multi.joint_names or multi.points or components:
                raise InvalidTrajectoryError("joints with several degrees of freedom: this controller has none")
            self._controller.submit(self._request(request.trajectory, request, goal))
        except InvalidTrajectoryError as error:
            self._controller.reject(goal, error)

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
            self._controller.reject(None, error)

    def _query(self, request: Any, response: Any) -> Any:
        time = _nanoseconds(request.time)
        try:
            response.message, state = self._queue.call(lambda: self._controller.state_at(time))
        except TimeoutError as error:
            response.message, state = str(error), np.zeros((3, 0))
        response.success = not response.message
        if state.size:
            response.name = self._names
        response.position, response.velocity, response.acceleration = map(sequence, state)
        return response

    def _request(self, trajectory: Any, goal: Any, client: TrajectoryGoal | None) -> TrajectoryRequest:
        """Checked request; raises ``InvalidTrajectoryError``."""
        if self._rejection:
            raise InvalidTrajectoryError(self._rejection)
        controller, settings = self._controller, self._controller.settings
        points = [
            Point(p.positions, p.velocities, p.accelerations, p.effort, _nanoseconds(p.time_from_start) * 1e-9)
            for p in trajectory.points
        ]
        waypoints = check_waypoints(
            list(trajectory.joint_names),
            points,
            controller.limits,
            allow_partial=settings.allow_partial_joints_goal,
            at_rest=client is not None,
        )
        path, at_goal, goal_time = settings.path, settings.goal, settings.goal_time
        if goal is not None:
            path = stated(path, goal.path_tolerance, self._names, "path_tolerance")
            at_goal = stated(at_goal, goal.goal_tolerance, self._names, "goal_tolerance")
            late = _nanoseconds(goal.goal_time_tolerance) * 1e-9
            if late < 0 and not np.isclose(late, -1.0):
                raise InvalidTrajectoryError(
                    f"goal_time_tolerance is {late:g} s; expected 0 or more, or -1 (unchecked)"
                )
            if late:
                goal_time = max(0.0, late)
        return TrajectoryRequest(waypoints, _nanoseconds(trajectory.header.stamp), path, at_goal, goal_time, client)


def serve_tracking(node: ProcessNode, bases: Sequence[str], controller: TrackingController) -> None:
    """Serve the action of a tracking controller, which rejects all goals with the reason."""

    def reject(server: DeferredActionServer, handle: ServerGoalHandle) -> None:
        _log.warning("%s", controller.rejection)
        server.finish(handle, "abort", _result(ErrorCode.INVALID_GOAL, controller.rejection))

    for base in bases:
        _serve(node, base, reject, lambda _: CancelResponse.REJECT)


class ControllerStatePublisher:
    """``~/controller_state``, published while the controller is active and has subscribers."""

    def __init__(self, node: Node, topics: Sequence[str], controller: Limb, stamp: Time, rate: float) -> None:
        """Open the topics; the reference of a tracking controller is the Motion System's set-point.

        ``stamp``: robot time, updated by its owner.
        """
        self.rate = rate  # [Hz]; may be changed from any thread
        self._controller, self._schedule = controller, Schedule()
        self._publishers = [node.create_publisher(JointTrajectoryControllerState, topic, 1) for topic in topics]
        names = list(controller.limits.names)
        self._message = JointTrajectoryControllerState(speed_scaling_factor=1.0, joint_names=names)
        self._message.header.stamp = stamp

    def publish(self, hw: ValorEscherHWInterface) -> None:
        controller = self._controller
        if not controller.active or not self._schedule.due(hw.time, round(1e9 / self.rate)):
            return
        publishers = [each for each in self._publishers if each.get_subscription_count()]
        if not publishers:
            return
        if isinstance(controller, JointTrajectoryController):
            reference = np.stack((controller.position, controller.velocity, controller.acceleration))
        else:
            reference = hw.commanded[None, controller.joints]
        feedback = np.stack((hw.position[controller.joints], hw.velocity[controller.joints]))
        message = self._message
        message.reference = message.output = _point(reference)
        message.feedback = _point(feedback)
        message.error = _point(reference[:2] - feedback[: len(reference)])
        for publisher in publishers:
            publisher.publish(message)
