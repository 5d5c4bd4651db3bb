"""What the robot's messages say, taken into ``Heard``: of a robot that runs, or out of a recording."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped, WrenchStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, JointState
from std_msgs.msg import Bool
from valor_msgs.msg import GroundTruth, HandGoalStatus, MotionState, Rejection
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_humanoid_control_msgs.msg import ControlModeStatus

from valor.common.fetching import PICTURE
from valor.common.poses import Pose
from valor.common.topics import GROUND_TRUTH
from valor.operator_station.heard import Heard
from valor.operator_station.link import AGES, Link
from valor.operator_station.modes import Mode, report
from valor.ros.limbs import FEET, HANDS, WRENCH

STREAM = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Of what comes again and again: the newest alone counts."""
TOLD = QoSProfile(depth=20, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Of what is said on change."""
EVENTS = QoSProfile(depth=20)
POINTS = ("com", "dcm", "dcm_reference", "cop")
NUMBERS = ("tick_time", "motor_time", "qp_failures", "torque_saturations")
STATES = ("behavior", "locomotion", "manipulation", "attention", "reason")


@dataclass(frozen=True)
class Input:
    """A topic that is heard.

    Attributes:
        kind: of its messages.
        topic: relative to the robot's namespace.
        qos: ``STREAM``, ``TOLD`` or ``EVENTS``.
        take: takes a message in; now: [s] of the clock of ``Heard.ages``.
    """

    kind: Any
    topic: str
    qos: QoSProfile
    take: Callable[[Any, float], None]


class Intake:
    """Takes messages into ``heard``. From one thread.

    Attributes:
        heard: the newest of everything.
        inputs: whose messages are wanted.
    """

    def __init__(
        self, wall: Callable[[], float] = time.time, linked: bool = False, recorded: bool = False, camera: str = ""
    ) -> None:
        """Nothing is heard yet.

        Args:
            wall: the wall clock at which things are noted [s].
            linked: whether the robot is behind the link, which says how old its state is.
            recorded: whether it is out of a bag, in which Bifrost's topics are ROS' as well.
            camera: topic of the robot's view, where it is not behind the link; empty: there is none.
        """
        self.heard, self.wall = Heard(), wall
        if linked:
            self.heard.ages.by_others(AGES)
        self.inputs: list[Input] = []
        add = self._add
        add(JointState, "joint_states", STREAM, self._joints)
        add(PoseStamped, "flor/state/pelvis_pose_world", STREAM, self._pelvis)
        add(MotionState, "flor/controller/motion_state", STREAM, self._motion)
        for name in POINTS:
            add(PointStamped, f"flor/state/{name}", STREAM, self._point(name))
        for name in FEET:
            add(WrenchStamped, WRENCH.format(name), STREAM, self._wrench(name))
        for place, name in enumerate(FEET):
            add(Bool, f"flor/{name}/contact", TOLD, self._contact(place))
        for name in HANDS:
            add(HandGoalStatus, f"flor/{name}/goal_status", TOLD, self._hand(name))
        add(ControlModeStatus, "flor/controller/mode", TOLD, self._mode)
        add(DiagnosticStatus, "flor/controller/robot_status", TOLD, self._status)
        add(Rejection, "flor/controller/rejection", EVENTS, self._rejection)
        add(DiagnosticArray, "diagnostics", EVENTS, self._diagnostics)
        add(
            ExecuteStepPlan.Impl.FeedbackMessage,
            "robot_controllers/footstep_controller/execute_feedback",
            TOLD,
            self._plan,
        )
        if linked:
            add(DiagnosticStatus, "link/status", TOLD, self._link)
            add(CompressedImage, PICTURE, TOLD, self._picture)
        elif camera:
            add(CompressedImage, camera, STREAM, self._picture)
        if recorded:
            add(GroundTruth, f"bifrost/{GROUND_TRUTH.name}", STREAM, self._truth)

    def _add(self, kind: Any, topic: str, qos: QoSProfile, take: Callable[[Any, float], None]) -> None:
        self.inputs.append(Input(kind, topic, qos, take))

    def _joints(self, message: JointState, now: float) -> None:
        heard, names = self.heard, message.name
        heard.joints = dict(zip(names, message.position, strict=False))
        heard.velocities = dict(zip(names, message.velocity, strict=False))
        heard.efforts = dict(zip(names, message.effort, strict=False))
        heard.time = _seconds(message.header.stamp)
        heard.ages.heard("joints", now)

    def _pelvis(self, message: PoseStamped, now: float) -> None:
        p, q = message.pose.position, message.pose.orientation
        self.heard.pelvis = Pose((p.x, p.y, p.z), (q.w, q.x, q.y, q.z))
        self.heard.ages.heard("pelvis", now)

    def _motion(self, message: MotionState, now: float) -> None:
        heard = self.heard
        heard.commanded = np.array(message.joint_setpoint)
        heard.numbers = {name: float(getattr(message, name)) for name in NUMBERS}
        before = heard.states.get("behavior")
        heard.states = {name: getattr(message, name) for name in STATES}
        if before is not None and before != message.behavior:
            heard.tell(self.wall(), f"behavior {before} → {message.behavior}: {message.reason or 'asked for'}")
        heard.ages.heard("motion", now)

    def _truth(self, message: GroundTruth, now: float) -> None:
        self.heard.fixtures = np.array(message.fixture_position)

    def _point(self, name: str) -> Callable[[PointStamped, float], None]:
        def take(message: PointStamped, now: float) -> None:
            self.heard.points[name] = np.array((message.point.x, message.point.y, message.point.z))
            self.heard.ages.heard(name, now)

        return take

    def _wrench(self, name: str) -> Callable[[WrenchStamped, float], None]:
        def take(message: WrenchStamped, now: float) -> None:
            f, t = message.wrench.force, message.wrench.torque
            self.heard.wrenches[name] = np.array((f.x, f.y, f.z, t.x, t.y, t.z))
            self.heard.ages.heard(name, now)

        return take

    def _contact(self, place: int) -> Callable[[Bool, float], None]:
        def take(message: Bool, now: float) -> None:
            self.heard.contacts[place] = message.data

        return take

    def _hand(self, name: str) -> Callable[[HandGoalStatus, float], None]:
        def take(message: HandGoalStatus, now: float) -> None:
            self.heard.hands[name] = (message.state, message.reason, message.position_error)
            self.heard.ages.heard(name, now)

        return take

    def _mode(self, message: ControlModeStatus, now: float) -> None:
        heard = self.heard
        mode = Mode(message.current_control_mode, message.requested_control_mode, message.status)
        if mode != heard.mode and (text := report(mode)):
            heard.tell(self.wall(), f"control mode: {text}")
        heard.mode = mode
        heard.modes.note(self.wall(), mode.current)
        heard.ages.heard("mode", now)

    def _status(self, message: DiagnosticStatus, now: float) -> None:
        level = message.level[0] if isinstance(message.level, bytes) else int(message.level)
        if level and (level, message.message) != self.heard.status:
            self.heard.tell(self.wall(), f"robot: {message.message}")
        self.heard.status = (level, message.message)
        self.heard.ages.heard("status", now)

    def _link(self, message: DiagnosticStatus, now: float) -> None:
        self.heard.link = link = Link.of(message.message, {pair.key: pair.value for pair in message.values})
        for name, key in AGES.items():
            if (age := link.age(key)) is not None:
                self.heard.ages.tell(name, age, now)
        self.heard.ages.heard("link", now)

    def _picture(self, message: CompressedImage, now: float) -> None:
        self.heard.picture = bytes(message.data)
        self.heard.ages.heard("picture", now)

    def _rejection(self, message: Rejection, now: float) -> None:
        self.heard.tell(self.wall(), f"refused {message.topic} of {message.origin}: {message.reason}")

    def _diagnostics(self, message: DiagnosticArray, now: float) -> None:
        for each in message.status:
            level = each.level[0] if isinstance(each.level, bytes) else int(each.level)
            self.heard.diagnostics[each.name] = (level, each.message)
            for pair in each.values:
                if pair.key.startswith("last ") and "refused" in pair.key and pair.value:
                    self.heard.diagnostics[pair.key] = (1, pair.value)
        self.heard.ages.heard("diagnostics", now)

    def _plan(self, message: Any, now: float) -> None:
        heard, told = self.heard, message.feedback
        heard.steps = []
        for step in told.feedback.steps:
            p, q = step.foot.pose.position, step.foot.pose.orientation
            pose = Pose((p.x, p.y, p.z), (q.w, q.x, q.y, q.z))
            heard.steps.append((step.step_index, step.foot.foot_index, pose))
        heard.executing = told.currently_executing_step_index
        if told.status.error_msg:
            heard.tell(self.wall(), f"footsteps: {told.status.error_msg}")
        heard.ages.heard("steps", now)


def _seconds(stamp: Any) -> float:
    return float(stamp.sec + 1e-9 * stamp.nanosec)
