"""Publishes the robot's state and progress in the operator's domain, under the topic names of the robot's domain."""

from collections.abc import Callable
from math import nan
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, TransformStamped, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CompressedImage, JointState
from std_msgs.msg import Bool, String
from tf2_msgs.msg import TFMessage
from valor_msgs.msg import HandGoalStatus, MotionState
from vigir_footstep_planning_msgs.msg import Step
from vigir_humanoid_control_msgs.msg import ControlModeStatus

from valor.common.arrays import FloatArray
from valor.common.behaviors import INTERNAL_STATES, Behavior
from valor.common.instance import Settings
from valor.common.linking import PICTURE
from valor.link.endpoints import OperatorEndpoint
from valor.link.errors import SealError
from valor.link.fields import UNKNOWN
from valor.link.picture import Picture
from valor.link.state import RobotState
from valor.robot.description import RobotDescription
from valor.robot.kinematic_tree import KinematicTree
from valor.ros import packed_steps
from valor.ros.limbs import FEET, HANDS, WRENCH
from valor.ros.progress import (
    FEEDBACK,
    GOAL_STATUS,
    FeedbackMessage,
    checksum,
    checksum_of,
    unpack_feedback,
    unpack_hand,
)
from valor.ros.transforms import ODOM, TransformPublisher

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
QUEUE = 5
LONGEST_AGE = 3600.0  # of a picture, that can be subtracted from the clock for a stamp [s]
PLANS = 4  # whose steps are stored
WATCHERS = QoSProfile(depth=20, durability=DurabilityPolicy.TRANSIENT_LOCAL)
MODE_PERIOD = 1000  # of a mode that has not changed [ms]


class Republisher:
    """Publishers of a state, for one thread."""

    def __init__(self, node: Node, robot: RobotDescription, settings: Settings) -> None:
        """Create publishers; publish what never changes."""
        tree, prefix = KinematicTree.load(robot), settings.frame_prefix
        self._robot, self._stamp = robot, Time()
        make = node.create_publisher
        self._clock = make(Clock, "clock", 1) if settings.variant == "simulation" else None
        self._joints = make(JointState, "joint_states", QUEUE)
        self._pose = make(PoseStamped, "flor/state/pelvis_pose_world", QUEUE)
        self._odometry = make(Odometry, "odom", QUEUE)
        self._wrenches = [make(WrenchStamped, WRENCH.format(foot), QUEUE) for foot in FEET]
        self._contacts = [make(Bool, f"flor/{foot}/contact", LATCHED) for foot in FEET]
        self._motion = make(MotionState, "flor/controller/motion_state", QUEUE)
        self._mode = make(ControlModeStatus, "flor/controller/mode", LATCHED)
        self._mode_name = make(String, "flor/controller/mode_name", LATCHED)
        self._status = make(DiagnosticStatus, "flor/controller/robot_status", LATCHED)
        self._frames = [
            prefix + tree.frame_of(site) for site in (robot.tables.feet.left.sole, robot.tables.feet.right.sole)
        ]
        self._odom, self._base = prefix + ODOM, prefix + tree.base_frame
        self._transforms = TransformPublisher(node, tree, robot, self._stamp, prefix=prefix)
        fixed = TransformStamped(child_frame_id=self._odom)
        fixed.header.frame_id = "map"
        make(TFMessage, "/tf_static", LATCHED).publish(TFMessage(transforms=[*self._transforms.fixed, fixed]))
        make(String, "robot_description", LATCHED).publish(String(data=tree.urdf))
        self._published: dict[str, Any] = {}
        self._published_mode: tuple[Any, int] = (None, 0)

    def tick(self, nanoseconds: int) -> None:
        """Publish the robot time in simulation."""
        if self._clock is not None:
            seconds, rest = divmod(nanoseconds, 10**9)
            self._clock.publish(Clock(clock=Time(sec=seconds, nanosec=rest)))

    def publish(self, state: RobotState) -> None:
        """Publish a state newer than the last; every header has its robot time."""
        self._stamp.sec, self._stamp.nanosec = divmod(state.stamp * 10**6, 10**9)
        joints = JointState(name=list(self._robot.joints), position=state.joints.tolist())
        joints.header.stamp = self._stamp
        self._joints.publish(joints)
        self._publish_base(state)
        for place in range(len(FEET)):
            message = WrenchStamped()
            message.header.stamp, message.header.frame_id = self._stamp, self._frames[place]
            _fill(message.wrench.force, state.foot_forces[3 * place : 3 * place + 3])
            _fill(message.wrench.torque, state.foot_torques[3 * place : 3 * place + 3])
            self._wrenches[place].publish(message)
            self._on_change(self._contacts[place], Bool(data=bool(state.contacts >> place & 1)))
        if state.behavior != UNKNOWN:
            self._motion.publish(motion_state(state))
        if state.mode != UNKNOWN:
            self._publish_mode(state)
        self._on_change(self._status, _status(state))

    def _publish_mode(self, state: RobotState) -> None:
        mode = ControlModeStatus(requested_control_mode=state.requested_mode, current_control_mode=state.mode,
                                 status=state.mode_status)  # fmt: skip
        mode.header.stamp = self._stamp
        told = (state.mode, state.requested_mode, state.mode_status)
        if told != self._published_mode[0] or state.clock - self._published_mode[1] >= MODE_PERIOD:
            self._published_mode = (told, state.clock)
            self._mode.publish(mode)
        self._on_change(self._mode_name, String(data=state.mode))

    def _publish_base(self, state: RobotState) -> None:
        pose, odometry = PoseStamped(), Odometry(child_frame_id=self._base)
        pose.header.stamp, pose.header.frame_id = self._stamp, self._odom
        _fill(pose.pose.position, state.base_position)
        q = pose.pose.orientation
        q.w, q.x, q.y, q.z = map(float, state.base_orientation)
        odometry.header, odometry.pose.pose = pose.header, pose.pose
        _fill(odometry.twist.twist.linear, state.base_velocity)
        _fill(odometry.twist.twist.angular, state.base_turn)
        self._pose.publish(pose)
        self._odometry.publish(odometry)
        self._transforms.publish(state.joints, state.base_position, state.base_orientation)

    def _on_change(self, publisher: Any, message: Any) -> None:
        if self._published.get(publisher.topic_name) != message:
            self._published[publisher.topic_name] = message
            publisher.publish(message)


class PicturePublisher:
    """Publishes each picture once, stamped with the time at which it was taken."""

    def __init__(self, node: Node, end: OperatorEndpoint) -> None:
        self._node, self._end = node, end
        self._publisher = node.create_publisher(CompressedImage, PICTURE, LATCHED)
        self._published: Picture | None = None

    def turn(self, now: float) -> None:
        """Publish a new picture; ``now``: monotonic [s]."""
        picture = self._end.picture
        if picture is None or picture is self._published:
            return
        self._published = picture
        message = CompressedImage(format=picture.form, data=picture.content)
        message.header.frame_id = picture.frame
        age, nanoseconds = self._end.picture_age(now), self._node.get_clock().now().nanoseconds
        seconds, rest = divmod(max(0, nanoseconds - round(1e9 * age)) if age < LONGEST_AGE else 0, 10**9)
        message.header.stamp = Time(sec=seconds, nanosec=rest)
        self._publisher.publish(message)


class Progress:
    """Publishers for one thread."""

    def __init__(self, node: Node, frame: str, publish_feedback: Callable[[int, Any], Any]) -> None:
        """``publish_feedback`` publishes feedback of the goal with a link id; returns the goal's id, or None."""
        self._frame, self._publish_feedback = frame, publish_feedback
        self._feedback = node.create_publisher(FeedbackMessage, FEEDBACK, WATCHERS)
        self._hands = [node.create_publisher(HandGoalStatus, GOAL_STATUS.format(hand), WATCHERS) for hand in HANDS]
        self._steps: dict[int, list[Step]] = {}
        self._newest: tuple[int, bytes] = (0, b"")

    def steps(self, content: bytes) -> None:
        """Store the steps of an active plan. Raises SealError: malformed."""
        self._steps[checksum(content)] = packed_steps.unpack(content)
        if self._newest[1] and checksum_of(self._newest[1]) == checksum(content):  # received after its feedback
            self.plan(*self._newest)
        while len(self._steps) > PLANS:
            del self._steps[next(iter(self._steps))]

    def plan(self, number: int, content: bytes) -> None:
        """Publish the feedback of a plan; ``number``: link id of its goal, 0 if another client sent it.

        Raises SealError: malformed.
        """
        message = unpack_feedback(content, self._steps, self._frame)
        self._newest = (number, content)
        if (goal_id := self._publish_feedback(number, message.feedback)) is not None:
            message.goal_id = goal_id
        self._feedback.publish(message)

    def hand(self, place: int, content: bytes) -> None:
        """Publish the status of a hand goal. Raises SealError: malformed."""
        if not 0 <= place < len(HANDS):
            raise SealError(f"hand {place}; expected one of {len(HANDS)}")
        self._hands[place].publish(unpack_hand(content, place))


def motion_state(state: RobotState) -> MotionState:
    """Motion state; numbers that the link does not carry are NaN, −1 or missing."""
    message = MotionState(
        time=state.stamp * 10**6, behavior=state.behavior, proprioceptor_sequence=-1,
        pelvis_position_in_odom=state.base_position.tolist(),
        pelvis_orientation_in_odom=state.base_orientation.tolist(),
        pelvis_angular_velocity_in_pelvis=state.base_turn.tolist(),
        contacts=[state.contacts >> place & 1 for place in range(len(FEET))],
        qp_failures=-1, torque_saturations=-1, motor_time=nan, tick_time=nan,
    )  # fmt: skip
    if state.behavior in tuple(Behavior):
        internal = INTERNAL_STATES[Behavior(state.behavior)]
        message.locomotion, message.manipulation, message.attention = map(str, internal)
    return message


def _status(state: RobotState) -> DiagnosticStatus:
    text = f"{state.behavior}: {state.faults} diagnostics are worse than ok" if state.faults else state.behavior
    values = {"behavior": state.behavior, "control_mode": state.mode, "faults": str(state.faults)}
    return DiagnosticStatus(
        level=bytes((state.fault_level,)), name="valor: robot", message=text,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )  # fmt: skip


def _fill(vector: Any, values: FloatArray) -> None:
    vector.x, vector.y, vector.z = map(float, values)
