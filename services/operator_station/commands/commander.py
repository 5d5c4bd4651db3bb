"""Goals and set-points for the robot's public ROS 2 interfaces, and their results.

A goal is sent once, to an available server only. One that is not acknowledged in time has failed; if it is accepted
later, it is cancelled.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from control_msgs.action import FollowJointTrajectory
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.action import ActionClient
from rclpy.executors import Executor, ExternalShutdownException, ShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Empty, String
from trajectory_msgs.msg import JointTrajectoryPoint
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus, Step
from vigir_humanoid_control_msgs.action import ChangeControlMode

from valor.common.errors import RefusalError
from valor.common.messages import ModeStatus
from valor.common.poses import Pose
from valor.operator_station.commands.log import Command
from valor.ros.controllers import COMMAND
from valor.ros.limbs import HANDS

ANSWER = 2.0  # timeout of an acknowledgement [s]
MODE = "mode_controllers/control_mode_controller/change_control_mode"
STEPS = "robot_controllers/footstep_controller/execute_step_plan"
TRAJECTORY = "trajectory_controllers/{}_traj_controller/follow_joint_trajectory"
TOPICS = dict(zip(("left", "right"), HANDS, strict=True))  # of the hands by side
NEWEST = QoSProfile(depth=1)  # volatile: later subscribers receive nothing old

Done = Callable[[Any], str]  # text of a result; raises RefusalError if it failed


class Commander:
    """Sends approved commands; called from the station's loop."""

    def __init__(self, node: Node, executor: Executor, groups: Sequence[str], frame: str = "odom") -> None:
        """Create the clients.

        Args:
            node: sends.
            executor: of the node, spun by a thread between ``start`` and ``close``.
            groups: of robot.yaml, with a trajectory controller.
            frame: odom in tf.
        """
        self._node, self._frame = node, frame
        self._modes = ActionClient(node, ChangeControlMode, MODE)
        self._plans = ActionClient(node, ExecuteStepPlan, STEPS)
        self._arms = {group: ActionClient(node, FollowJointTrajectory, TRAJECTORY.format(group)) for group in groups}
        self._velocity = node.create_publisher(Twist, "cmd_vel", NEWEST)
        self._controller = node.create_publisher(String, COMMAND, NEWEST)
        self._goals, self._releases = (
            {side: node.create_publisher(kind, f"flor/{name}/{topic}", NEWEST) for side, name in TOPICS.items()}
            for kind, topic in ((PoseStamped, "goal_pose"), (Empty, "goal_cancel"))
        )
        self._waiting: dict[int, tuple[Command, float]] = {}  # unacknowledged, with their timeouts, by sequence
        self._handles: dict[int, Any] = {}  # of running goals
        self._executor = executor
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="answers", daemon=True)

    def start(self) -> None:
        """Start to receive responses."""
        self._thread.start()

    def _spin(self) -> None:
        while not self._closing.is_set():
            try:
                self._executor.spin_once(timeout_sec=0.25)
            except (ExternalShutdownException, ShutdownException):
                return

    def close(self) -> None:
        """Stop to receive responses; running goals continue."""
        self._closing.set()
        self._executor.wake()
        if self._thread.is_alive():
            self._thread.join()

    def velocity(self, forward: float, left: float, turn: float) -> None:
        """Send a walking velocity [m/s, rad/s], valid for half a second."""
        message = Twist()
        message.linear.x, message.linear.y, message.angular.z = forward, left, turn
        self._velocity.publish(message)

    def change_mode(self, name: str, command: Command, then: Callable[[], None] | None = None) -> None:
        """Request a control mode; ``then`` is called by another thread when it is active."""

        def done(result: Any) -> str:
            status = result.result
            if not status.status & ModeStatus.MODE_ACCEPTED or status.current_control_mode != name:
                flags = [flag.name for flag in ModeStatus if status.status & flag and flag.name]
                raise RefusalError("mode", f"{', '.join(flags)}; it is {status.current_control_mode}")
            if then is not None:
                then()
            return f"control mode {name}"

        self._send(self._modes, ChangeControlMode.Goal(mode_request=name), command, done)

    def choose_controller(self, name: str, command: Command) -> None:
        """Request a controller; its status and rejections report the result."""
        self._publish(self._controller, String(data=name), command)

    def follow(self, group: str, joints: Mapping[str, float], duration: float, command: Command) -> None:
        """Move a group's joints to positions [rad] in a duration [robot time, s]."""
        goal = FollowJointTrajectory.Goal()
        goal.trajectory.joint_names = list(joints)
        point = JointTrajectoryPoint(positions=list(joints.values()), velocities=[0.0] * len(joints))
        point.accelerations = [0.0] * len(joints)
        point.time_from_start.sec, rest = divmod(round(duration * 1e9), 10**9)
        point.time_from_start.nanosec = rest
        goal.trajectory.points = [point]

        def done(result: Any) -> str:
            if result.error_code != FollowJointTrajectory.Result.SUCCESSFUL:
                raise RefusalError("trajectory", f"error {result.error_code}: {result.error_string}")
            return "arrived"

        self._send(self._arms[group], goal, command, done)

    def step(self, steps: Sequence[tuple[int, Pose]], command: Command) -> None:
        """Execute steps: foot (0 left, 1 right) and sole in odom."""
        goal = ExecuteStepPlan.Goal()
        goal.step_plan.header.frame_id = self._frame
        for index, (foot, sole) in enumerate(steps):
            message = Step(step_index=index, valid=True)
            message.foot.foot_index = foot
            _fill(message.foot.pose, sole)
            goal.step_plan.steps.append(message)

        def done(result: Any) -> str:
            if not result.status.status & FootstepExecutionStatus.REACHED_GOAL:
                raise RefusalError("steps", f"status {result.status.status}")  # the reason is in the feedback
            return "all steps taken"

        self._send(self._plans, goal, command, done)

    def lead_hand(self, side: str, pose: Pose, command: Command) -> None:
        """Send a hand's goal pose in odom; its goal status and rejections report the result."""
        message = PoseStamped()
        message.header.frame_id = self._frame
        _fill(message.pose, pose)
        self._publish(self._goals[side], message, command)

    def release_hand(self, side: str, command: Command) -> None:
        """Cancel a hand's goal; the arm stays in its position."""
        self._publish(self._releases[side], Empty(), command)

    def cancel(self) -> None:
        """Cancel all running goals of the station."""
        for handle in list(self._handles.values()):
            self._executor.create_task(handle.cancel_goal_async)
        self._executor.wake()

    def expire(self, now: float) -> None:
        """Mark goals as failed that are not acknowledged in time; ``now`` is monotonic [s]."""
        for sequence, (command, until) in list(self._waiting.items()):
            if now > until:
                del self._waiting[sequence]
                command.state, command.answer = "refused", f"not acknowledged within {ANSWER:g} s, given up"

    def _publish(self, publisher: Any, message: Any, command: Command) -> None:
        if not publisher.get_subscription_count():
            raise _absent(command, publisher.topic_name)
        publisher.publish(message)
        command.state, command.answer = "acknowledged", "handed over"

    def _send(self, client: Any, goal: Any, command: Command, done: Done) -> None:
        if not client.server_is_ready():
            raise _absent(command, client._action_name)
        self._waiting[command.sequence] = (command, time.monotonic() + ANSWER)

        def send() -> None:
            client.send_goal_async(goal).add_done_callback(lambda future: self._answered(future, command, done))

        # In the thread that receives the response, which else could arrive before the client has stored the request.
        self._executor.create_task(send)
        self._executor.wake()

    def _answered(self, future: Any, command: Command, done: Done) -> None:
        handle = future.result()
        if self._waiting.pop(command.sequence, None) is None:
            if handle is not None and handle.accepted:
                handle.cancel_goal_async()
            return
        if handle is None or not handle.accepted:
            command.state, command.answer = "refused", "the goal was refused; the VRC's diagnostics say why"
            return
        command.state = "acknowledged"
        self._handles[command.sequence] = handle
        handle.get_result_async().add_done_callback(lambda ended: self._ended(ended, command, done))

    def _ended(self, future: Any, command: Command, done: Done) -> None:
        self._handles.pop(command.sequence, None)
        try:
            command.state, command.answer = "done", done(future.result().result)
        except RefusalError as error:
            command.state, command.answer = "refused", str(error)


def _absent(command: Command, name: str) -> RefusalError:
    command.state, command.answer = "refused", f"nobody serves {name}: is the process that does ready?"
    return RefusalError("absent", command.line())


def _fill(message: Any, pose: Pose) -> None:
    p, q = message.position, message.orientation
    p.x, p.y, p.z = pose.position
    q.w, q.x, q.y, q.z = pose.orientation
