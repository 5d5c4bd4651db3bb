"""The ROS face of a joint trajectory controller: action, topics, query."""

from __future__ import annotations

import array
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory
from control_msgs.srv import QueryTrajectoryState
from rclpy.action import CancelResponse
from rclpy.action.server import ServerGoalHandle
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from valor.common.arrays import FloatArray
from valor.ros.deferred_action_server import DeferredActionServer
from valor.ros.node import ProcessNode
from valor.valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController
from valor.valor_ros_controller.controllers.trajectory_goal import Goal, Outcome, TrajectoryRequest, stated
from valor.valor_ros_controller.trajectory.admission import check_waypoints
from valor.valor_ros_controller.trajectory.errors import ErrorCode, InvalidTrajectoryError
from valor.valor_ros_controller.trajectory.tolerances import Tolerances
from valor.valor_ros_controller.trajectory.waypoints import Point
from valor.valor_ros_controller.update_queue import UpdateQueue
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface


def _nanoseconds(time: Any) -> int:
    """Of a Time or a Duration."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def _numbers(values: FloatArray) -> array.array[float]:
    """What rclpy's setters take without looking at each element."""
    return array.array("d", values.tobytes())


def _point(position: FloatArray, velocity: FloatArray, acceleration: FloatArray | None, since_start: int) -> Any:
    seconds, nanoseconds = divmod(since_start, 1_000_000_000)
    point = JointTrajectoryPoint(
        positions=_numbers(position),
        velocities=_numbers(velocity),
        time_from_start=Duration(sec=seconds, nanosec=nanoseconds),
    )
    if acceleration is not None:
        point.accelerations = _numbers(acceleration)
    return point


def _late(why: str) -> Any:
    return FollowJointTrajectory.Result(error_code=FollowJointTrajectory.Result.OLD_HEADER_TIMESTAMP, error_string=why)


def serve(
    node: ProcessNode,
    base: str,
    on_goal: Callable[[DeferredActionServer, ServerGoalHandle], None],
    on_cancel: Callable[[ServerGoalHandle], CancelResponse],
) -> None:
    """Serve ``follow_joint_trajectory`` under a name; ``on_goal`` is told which server is to finish the goal."""

    def begin(handle: ServerGoalHandle) -> None:
        on_goal(server, handle)

    server = DeferredActionServer(
        node,
        FollowJointTrajectory,
        f"{base}/follow_joint_trajectory",
        begin,
        on_cancel,
        late=_late if node.others else None,
    )


class _TrajectoryGoal:
    """A goal of the action."""

    def __init__(self, face: JointTrajectoryAction, server: DeferredActionServer, handle: ServerGoalHandle) -> None:
        self._face = face
        self._server = server
        self._handle = handle

    def finish(self, outcome: Outcome) -> None:
        ended = "succeed" if outcome.code is ErrorCode.SUCCESSFUL else "abort"
        state = "canceled" if outcome.canceled else ended
        result = FollowJointTrajectory.Result(error_code=int(outcome.code), error_string=outcome.text)
        self._face.forget(self._handle)
        self._server.finish(self._handle, state, result)

    def feedback(self, hw: ValorEscherHWInterface) -> None:
        self._handle.publish_feedback(self._face.feedback(hw))


class JointTrajectoryAction:
    """Trajectories of one controller on ROS, under several names: one controller takes what comes by any of them.

    Attributes:
        topic: where trajectories come without a goal.
    """

    def __init__(
        self,
        node: ProcessNode,
        bases: Sequence[str],
        controller: JointTrajectoryController,
        stamp: Time,
        queue: UpdateQueue,
        *,
        refusal: str = "",
    ) -> None:
        """Open the interfaces.

        Args:
            node: the ROS node.
            bases: what the names of the interfaces begin with; ViGIR's first, which has the topic ``command``, too.
            controller: runs the trajectories.
            stamp: robot time, kept up to date by its owner.
            queue: into the update thread.
            refusal: why no trajectory is run; empty: they are.
        """
        self._refusal = refusal
        self._controller = controller
        self._stamp = stamp
        self._queue = queue
        self._names = list(controller.limits.names)
        self._goals: dict[bytes, Goal] = {}
        self.topic = f"{bases[0]}/joint_trajectory"
        node.create_subscription(JointTrajectory, f"{bases[0]}/command", self._command, 1)
        for base in bases:
            serve(node, base, self._goal, self._cancel)
            node.create_subscription(JointTrajectory, f"{base}/joint_trajectory", self._command, 1)
            node.create_service(QueryTrajectoryState, f"{base}/query_state", self._query)

    # --- update thread --------------------------------------------------------------------------------------------

    def feedback(self, hw: ValorEscherHWInterface) -> Any:
        """The action's feedback for this cycle."""
        controller = self._controller
        position, velocity = hw.position[controller.joints], hw.velocity[controller.joints]
        since = hw.time - controller.trajectory_start
        feedback = FollowJointTrajectory.Feedback(joint_names=self._names)
        feedback.header.stamp = self._stamp
        feedback.desired = _point(controller.position, controller.velocity, controller.acceleration, since)
        feedback.actual = _point(position, velocity, None, since)
        feedback.error = _point(controller.position - position, controller.velocity - velocity, None, since)
        return feedback

    # --- ROS thread -----------------------------------------------------------------------------------------------

    def forget(self, handle: ServerGoalHandle) -> None:
        """A goal has ended. From any thread."""
        self._goals.pop(bytes(handle.goal_id.uuid), None)

    def _goal(self, server: DeferredActionServer, handle: ServerGoalHandle) -> None:
        goal = _TrajectoryGoal(self, server, handle)
        self._goals[bytes(handle.goal_id.uuid)] = goal
        request = handle.request
        try:
            multi = request.multi_dof_trajectory
            components = request.component_path_tolerance or request.component_goal_tolerance
            if multi.joint_names or multi.points or components:
                raise InvalidTrajectoryError("joints with several degrees of freedom: this controller has none")
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

    def _query(self, request: Any, response: Any) -> Any:
        """Where the trajectory is at a time."""
        time = _nanoseconds(request.time)
        try:
            response.message, state = self._queue.call(lambda: self._controller.state_at(time))
        except TimeoutError as error:
            response.message, state = str(error), np.zeros((3, 0))
        response.success = not response.message
        if state.size:
            response.name = self._names
        response.position, response.velocity, response.acceleration = map(_numbers, state)
        return response

    def _request(self, trajectory: Any, goal: Any, client: Goal | None) -> TrajectoryRequest:
        """Check what came.

        Raises:
            InvalidTrajectoryError: it is not to be run.
        """
        if self._refusal:
            raise InvalidTrajectoryError(self._refusal)
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
            path = self._stated(path, goal, "path_tolerance")
            at_goal = self._stated(at_goal, goal, "goal_tolerance")
            late = _nanoseconds(goal.goal_time_tolerance) * 1e-9
            if late < 0 and not np.isclose(late, -1.0):
                raise InvalidTrajectoryError(
                    f"goal_time_tolerance is {late:g} s; expected 0 or more, or -1 (unchecked)"
                )
            if late:
                goal_time = max(0.0, late)
        return TrajectoryRequest(waypoints, _nanoseconds(trajectory.header.stamp), path, at_goal, goal_time, client)

    def _stated(self, default: Tolerances, goal: Any, which: str) -> Tolerances:
        entries = [(entry.name, entry.position, entry.velocity) for entry in getattr(goal, which)]
        return stated(default, entries, self._names, which)
