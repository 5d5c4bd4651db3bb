"""Input of ROS messages into ``RobotSnapshot``."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped, WrenchStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, JointState
from std_msgs.msg import Bool
from valor_msgs.msg import ControllerStatus, HandGoalStatus, MotionState, Rejection
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_humanoid_control_msgs.msg import ControlModeStatus

from valor.common.linking import PICTURE
from valor.common.poses import Pose
from valor.operator_station.robot.modes import Mode, report
from valor.operator_station.robot.snapshot import AGES, LinkStatus, RobotSnapshot
from valor.ros.controllers import STATUS
from valor.ros.limbs import FEET, HANDS, WRENCH
from valor.ros.taking import polled, take

STREAM = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Periodic: only the latest counts."""
TOLD = QoSProfile(depth=20, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Sent on change."""
EVENTS = QoSProfile(depth=20)
POINTS = ("com", "dcm", "dcm_reference", "cop")
STATES = ("behavior", "locomotion", "manipulation", "attention", "reason")


@dataclass(frozen=True)
class Input:
    """Topic relative to the robot's namespace; ``take`` receives messages with the monotonic time [s]."""

    kind: Any
    topic: str
    qos: QoSProfile
    take: Callable[[Any, float], None]


class Intake:
    """Stores messages in ``heard``; used from one thread."""

    def __init__(self, wall: Callable[[], float] = time.time, linked: bool = False, camera: str = "") -> None:
        """``linked``: the link reports ages; ``camera``: topic of pictures of a local robot, empty without one."""
        self.heard, self.wall = RobotSnapshot(), wall
        if linked:
            self.heard.ages.by_others(AGES)
        self.inputs: list[Input] = []

        def add(kind: Any, topic: str, qos: QoSProfile, take: Callable[[Any, float], None]) -> None:
            self.inputs.append(Input(kind, topic, qos, take))

        add(JointState, "joint_states", STREAM, self._joints)
        add(PoseStamped, "flor/state/pelvis_pose_world", STREAM, self._pelvis)
        add(MotionState, "flor/controller/motion_state", STREAM, self._motion)
        for name in POINTS:
            add(PointStamped, f"flor/state/{name}", STREAM, partial(self._point, name))
        for name in FEET:
            add(WrenchStamped, WRENCH.format(name), STREAM, partial(self._wrench, name))
        for place, name in enumerate(FEET):
            add(Bool, f"flor/{name}/contact", TOLD, partial(self._contact, place))
        for name in HANDS:
            add(HandGoalStatus, f"flor/{name}/goal_status", TOLD, partial(self._hand, name))
        add(ControlModeStatus, "flor/controller/mode", TOLD, self._mode)
        add(DiagnosticStatus, "flor/controller/robot_status", TOLD, self._status)
        add(ControllerStatus, STATUS, TOLD, self._controllers)
        add(Rejection, "flor/controller/rejection", EVENTS, self._rejection)
        feedback = "robot_controllers/footstep_controller/execute_feedback"
        add(ExecuteStepPlan.Impl.FeedbackMessage, feedback, TOLD, self._plan)
        if linked:
            add(DiagnosticStatus, "link/status", TOLD, self._link)
            add(CompressedImage, PICTURE, TOLD, self._picture)
        elif camera:
            add(CompressedImage, camera, STREAM, self._picture)

    def listen(self, node: Node) -> None:
        """Subscribe."""
        self._received = [(polled(node, each.kind, each.topic, each.qos), each.take) for each in self.inputs]

    def look(self, now: float) -> None:
        """Store received messages; ``now`` is monotonic [s]."""
        for subscription, receive in self._received:
            while (taken := take(subscription)) is not None:
                receive(taken[0], now)

    def _joints(self, message: JointState, now: float) -> None:
        self.heard.joints = dict(zip(message.name, message.position, strict=False))
        self.heard.ages.heard("joints", now)

    def _pelvis(self, message: PoseStamped, now: float) -> None:
        self.heard.pelvis = _pose(message.pose)
        self.heard.ages.heard("pelvis", now)

    def _motion(self, message: MotionState, now: float) -> None:
        heard = self.heard
        before = heard.states.get("behavior")
        heard.states = {name: getattr(message, name) for name in STATES}
        if before is not None and before != message.behavior:
            heard.tell(self.wall(), f"behavior {before} → {message.behavior}: {message.reason or 'asked for'}")
        heard.ages.heard("motion", now)

    def _point(self, name: str, message: PointStamped, now: float) -> None:
        self.heard.points[name] = np.array((message.point.x, message.point.y, message.point.z))
        self.heard.ages.heard(name, now)

    def _wrench(self, name: str, message: WrenchStamped, now: float) -> None:
        f, t = message.wrench.force, message.wrench.torque
        self.heard.wrenches[name] = np.array((f.x, f.y, f.z, t.x, t.y, t.z))
        self.heard.ages.heard(name, now)

    def _contact(self, place: int, message: Bool, now: float) -> None:
        self.heard.contacts[place] = message.data

    def _hand(self, name: str, message: HandGoalStatus, now: float) -> None:
        self.heard.hands[name] = (message.state, message.reason, message.position_error)
        self.heard.ages.heard(name, now)

    def _mode(self, message: ControlModeStatus, now: float) -> None:
        heard = self.heard
        mode = Mode(message.current_control_mode, message.requested_control_mode, message.status)
        if mode != heard.mode and (text := report(mode)):
            heard.tell(self.wall(), f"control mode: {text}")
        heard.mode = mode
        heard.ages.heard("mode", now)

    def _controllers(self, message: ControllerStatus, now: float) -> None:
        before, self.heard.controllers = self.heard.controllers, message
        if message.reason and (before is None or before.reason != message.reason):
            self.heard.tell(self.wall(), f"controller: {message.reason}")

    def _status(self, message: DiagnosticStatus, now: float) -> None:
        level = message.level[0] if isinstance(message.level, bytes) else int(message.level)
        if level and (level, message.message) != self.heard.status:
            self.heard.tell(self.wall(), f"robot: {message.message}")
        self.heard.status = (level, message.message)
        self.heard.ages.heard("status", now)

    def _link(self, message: DiagnosticStatus, now: float) -> None:
        self.heard.link = link = LinkStatus(message.message, {pair.key: pair.value for pair in message.values})
        for name, key in AGES.items():
            if (age := link.age(key)) is not None:
                self.heard.ages.tell(name, age, now)
        self.heard.ages.heard("link", now)

    def _picture(self, message: CompressedImage, now: float) -> None:
        self.heard.picture = bytes(message.data)
        self.heard.ages.heard("picture", now)

    def _rejection(self, message: Rejection, now: float) -> None:
        self.heard.tell(self.wall(), f"refused {message.topic} of {message.origin}: {message.reason}")

    def _plan(self, message: Any, now: float) -> None:
        heard, told = self.heard, message.feedback
        steps = told.feedback.steps
        heard.steps = [(step.step_index, step.foot.foot_index, _pose(step.foot.pose)) for step in steps]
        if told.status.error_msg:
            heard.tell(self.wall(), f"footsteps: {told.status.error_msg}")
        heard.ages.heard("steps", now)


def _pose(message: Any) -> Pose:
    p, q = message.position, message.orientation
    return Pose((p.x, p.y, p.z), (q.w, q.x, q.y, q.z))
