"""What the robot says on ROS, looked at when a state is to be sent, and nothing between."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from valor_msgs.msg import HandGoalStatus, MotionState, Rejection
from vigir_humanoid_control_msgs.msg import ControlModeStatus

from valor.common.arrays import FloatArray
from valor.link.state import RobotState
from valor.robot.description import RobotDescription
from valor.ros.limbs import FEET, HANDS, WRENCH
from valor.ros.node import Untouched
from valor.ros.progress import FEEDBACK, GOAL_STATUS, FeedbackMessage
from valor.ros.taking import uncalled, waiting

STREAM = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
KEPT = 10  # of the joints, which come more often than the base: the last ones
TOLD = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
EVENTS = QoSProfile(depth=20)


class Observer:
    """Keeps the newest of each.

    Attributes:
        rejections: that came since they were taken.
    """

    def __init__(self, node: Node, robot: RobotDescription) -> None:
        """``node``: the executor leaves these subscriptions alone."""
        self._node, self._group = node, Untouched()
        self._robot = robot
        self._joints: deque[JointState] = deque(maxlen=KEPT)
        self._newest: dict[str, Any] = {}
        self._heard: dict[str, float] = {}
        self._order: list[int] = []
        self._looked = time.monotonic()
        self.rejections: list[Rejection] = []
        self._inputs = [
            (name, node.create_subscription(kind, topic, uncalled, qos, callback_group=self._group))
            for name, kind, topic, qos in (
                ("joints", JointState, "joint_states", QoSProfile(depth=KEPT, reliability=STREAM.reliability)),
                ("base", Odometry, "odom", STREAM),
                ("motion", MotionState, "flor/controller/motion_state", STREAM),
                ("mode", ControlModeStatus, "flor/controller/mode", TOLD),
                ("status", DiagnosticStatus, "flor/controller/robot_status", TOLD),
                ("diagnostics", DiagnosticArray, "diagnostics", STREAM),
                ("steps", FeedbackMessage, FEEDBACK, TOLD),
                *((hand, HandGoalStatus, GOAL_STATUS.format(hand), TOLD) for hand in HANDS),
                *((foot, WrenchStamped, WRENCH.format(foot), STREAM) for foot in FEET),
                ("rejection", Rejection, "flor/controller/rejection", EVENTS),
            )
        ]

    def look(self) -> None:
        """Take what has come."""
        now = time.monotonic()
        for name, subscription in self._inputs:
            for message in waiting(subscription):
                if name == "rejection":
                    self.rejections.append(message)
                    continue
                if name == "joints":
                    self._joints.append(message)
                self._newest[name] = message
                self._heard[name] = self._looked  # it came since, no earlier
        self._looked = now

    def newest(self, name: str) -> Any:
        """What was heard last: ``steps``, or of a hand; None: nothing."""
        return self._newest.get(name)

    def state(self) -> RobotState | None:
        """The newest whose joints and base are of one moment; None: joints have not been heard."""
        self.look()
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
        """The joints as they were with the newest base; the newest where it is too old for that."""
        base = self._newest.get("base")
        stamp = base.header.stamp if base is not None else None
        return next((joints for joints in self._joints if joints.header.stamp == stamp), self._joints[-1])

    def _fill_base(self, state: RobotState) -> None:
        if (odometry := self._newest.get("base")) is not None:
            pose, twist = odometry.pose.pose, odometry.twist.twist
            state.base_position = _vector(pose.position)
            state.base_orientation = np.array((pose.orientation.w, *_vector(pose.orientation)))
            state.base_velocity, state.base_turn = _vector(twist.linear), _vector(twist.angular)
        for place, foot in enumerate(FEET):
            if (message := self._newest.get(foot)) is not None:
                state.foot_forces[3 * place : 3 * place + 3] = _vector(message.wrench.force)
                state.foot_torques[3 * place : 3 * place + 3] = _vector(message.wrench.torque)

    def _fill_mode(self, state: RobotState) -> None:
        now, newest = time.monotonic(), self._newest
        if (mode := newest.get("mode")) is not None:
            state.mode, state.requested_mode = mode.current_control_mode, mode.requested_control_mode
            state.mode_status, state.mode_age = mode.status, now - self._heard["mode"]
        if (motion := newest.get("motion")) is not None:
            state.behavior, state.behavior_age = motion.behavior, now - self._heard["motion"]
            state.contacts = sum(1 << place for place, contact in enumerate(motion.contacts) if contact)
        if (status := newest.get("status")) is not None:
            state.fault_level = _level(status)
        if (diagnostics := newest.get("diagnostics")) is not None:
            state.faults = sum(_level(each) > 0 for each in diagnostics.status)
        if (steps := newest.get("steps")) is not None:
            state.step = steps.feedback.currently_executing_step_index


def _level(status: DiagnosticStatus) -> int:
    return int(status.level[0] if isinstance(status.level, bytes) else status.level)


def _vector(each: Any) -> FloatArray:
    return np.array((each.x, each.y, each.z))


def _milliseconds(stamp: Any) -> int:
    return int(1000 * stamp.sec + stamp.nanosec // 10**6)
