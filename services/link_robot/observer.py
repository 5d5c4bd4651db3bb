"""Latest messages of the robot's ROS topics, taken when a state is to be sent."""

import time
from collections import deque
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, JointState
from valor_msgs.msg import ControllerStatus, HandGoalStatus, MotionState, Rejection
from vigir_humanoid_control_msgs.msg import ControlModeStatus

from valor.common.arrays import FloatArray
from valor.link.picture import Picture
from valor.link.state import RobotState
from valor.robot.description import RobotDescription
from valor.ros.controllers import STATUS
from valor.ros.limbs import FEET, HANDS, WRENCH
from valor.ros.progress import FEEDBACK, GOAL_STATUS, FeedbackMessage
from valor.ros.taking import polled, take, waiting

STREAM = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
JOINT_MESSAGES = 10  # stored: joints are published more often than the base
JOINTS = QoSProfile(depth=JOINT_MESSAGES, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
EVENTS = QoSProfile(depth=20)


class Observer:
    """Stores the latest message of each topic."""

    def __init__(self, node: Node, robot: RobotDescription) -> None:
        """``node``: its executor does not serve these subscriptions."""
        self._node = node
        self._robot = robot
        self._joints: deque[JointState] = deque(maxlen=JOINT_MESSAGES)
        self._latest: dict[str, Any] = {}
        self._received_at: dict[str, float] = {}
        self._order: list[int] = []
        self._taken_at = time.monotonic()
        self.rejections: list[Rejection] = []  # received; the caller clears them
        self._inputs = [
            (name, polled(node, kind, topic, qos))
            for name, kind, topic, qos in (
                ("joints", JointState, "joint_states", JOINTS),
                ("base", Odometry, "odom", STREAM),
                ("motion", MotionState, "flor/controller/motion_state", STREAM),
                ("mode", ControlModeStatus, "flor/controller/mode", LATCHED),
                ("status", DiagnosticStatus, "flor/controller/robot_status", LATCHED),
                ("diagnostics", DiagnosticArray, "diagnostics", STREAM),
                ("controllers", ControllerStatus, STATUS, LATCHED),
                ("steps", FeedbackMessage, FEEDBACK, LATCHED),
                *((hand, HandGoalStatus, GOAL_STATUS.format(hand), LATCHED) for hand in HANDS),
                *((foot, WrenchStamped, WRENCH.format(foot), STREAM) for foot in FEET),
                ("rejection", Rejection, "flor/controller/rejection", EVENTS),
            )
        ]

    def take(self) -> None:
        """Take received messages."""
        now = time.monotonic()
        for name, subscription in self._inputs:
            for message in waiting(subscription):
                if name == "rejection":
                    self.rejections.append(message)
                    continue
                if name == "joints":
                    self._joints.append(message)
                self._latest[name] = message
                self._received_at[name] = self._taken_at  # upper bound of its age: received since the last take
        self._taken_at = now

    def latest(self, name: str) -> Any:
        """Latest message: ``controllers``, ``steps``, or of a hand; None if none was received."""
        return self._latest.get(name)

    def state(self) -> RobotState | None:
        """Latest state with joints and base of one time; None if no joints were received."""
        self.take()
        if not self._joints:
            return None
        joints = self._joints_with_base()
        if not self._order:
            self._order = [joints.name.index(name) for name in self._robot.joints]
        state = RobotState(joints=np.asarray(joints.position)[self._order], stamp=_milliseconds(joints.header.stamp))
        self._fill_base(state)
        self._fill_mode(state)
        return state

    def _joints_with_base(self) -> JointState:
        """Joints of the latest base's stamp; the latest joints if those are not stored any more."""
        base = self._latest.get("base")
        stamp = base.header.stamp if base is not None else None
        return next((joints for joints in self._joints if joints.header.stamp == stamp), self._joints[-1])

    def _fill_base(self, state: RobotState) -> None:
        if (odometry := self._latest.get("base")) is not None:
            pose, twist = odometry.pose.pose, odometry.twist.twist
            state.base_position = _vector(pose.position)
            state.base_orientation = np.array((pose.orientation.w, *_vector(pose.orientation)))
            state.base_velocity, state.base_turn = _vector(twist.linear), _vector(twist.angular)
        for index, foot in enumerate(FEET):
            if (message := self._latest.get(foot)) is not None:
                state.foot_forces[3 * index : 3 * index + 3] = _vector(message.wrench.force)
                state.foot_torques[3 * index : 3 * index + 3] = _vector(message.wrench.torque)

    def _fill_mode(self, state: RobotState) -> None:
        now, latest = time.monotonic(), self._latest
        if (mode := latest.get("mode")) is not None:
            state.mode, state.requested_mode = mode.current_control_mode, mode.requested_control_mode
            state.mode_status, state.mode_age = mode.status, now - self._received_at["mode"]
        if (motion := latest.get("motion")) is not None:
            state.behavior, state.behavior_age = motion.behavior, now - self._received_at["motion"]
            state.contacts = sum(1 << place for place, contact in enumerate(motion.contacts) if contact)
        if (status := latest.get("status")) is not None:
            state.fault_level = _level(status)
        if (diagnostics := latest.get("diagnostics")) is not None:
            state.faults = sum(_level(each) > 0 for each in diagnostics.status)
        if (steps := latest.get("steps")) is not None:
            state.step = steps.feedback.currently_executing_step_index


class View:
    """Latest picture of the topic ``link: picture``, subscribed to while the operator's end is connected."""

    def __init__(self, node: Node, topic: str) -> None:
        """``topic``: of ``CompressedImage``; empty if there is no camera."""
        self._node, self._topic = node, topic
        self._subscription: Any = None
        self._picture: Picture | None = None

    def subscribe(self, wanted: bool) -> None:
        """Subscribe, or unsubscribe and discard the picture."""
        if wanted and self._subscription is None and self._topic:
            self._subscription = polled(self._node, CompressedImage, self._topic, STREAM)
        elif not wanted and self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription, self._picture = None, None

    def latest(self, clock: float) -> Picture | None:
        """Latest picture received, None if there is none; ``clock``: of the robot's end [s]."""
        while self._subscription is not None and (taken := take(self._subscription)) is not None:
            message, stamps = taken
            age = max(0.0, time.time() - 1e-9 * stamps["source_timestamp"])  # since its publication
            taken_at = max(1, round(1e3 * (clock - age)))
            self._picture = Picture(taken_at, message.format, message.header.frame_id, bytes(message.data))
        return self._picture


def _level(status: DiagnosticStatus) -> int:
    return int(status.level[0] if isinstance(status.level, bytes) else status.level)


def _vector(each: Any) -> FloatArray:
    return np.array((each.x, each.y, each.z))


def _milliseconds(stamp: Any) -> int:
    return int(1000 * stamp.sec + stamp.nanosec // 10**6)
