"""The robot's state in the operator's domain, under the names that it has in the robot's."""

from __future__ import annotations

from math import nan
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, TransformStamped, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from tf2_msgs.msg import TFMessage
from valor_msgs.msg import MotionState
from vigir_humanoid_control_msgs.msg import ControlModeStatus

from valor.common.arrays import FloatArray
from valor.common.behaviors import INTERNAL_STATES, Behavior
from valor.common.instance import Settings
from valor.link.fields import UNKNOWN
from valor.link.state import RobotState
from valor.robot.description import RobotDescription
from valor.robot.kinematic_tree import KinematicTree
from valor.ros.limbs import FEET, WRENCH
from valor.ros.transforms import ODOM, TransformPublisher

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
QUEUE = 5
MODE_AGAIN = 1000  # a mode that has not changed is published again [ms]


class Republisher:
    """Publishes a state when it has come. From one thread."""

    def __init__(self, node: Node, robot: RobotDescription, settings: Settings) -> None:
        """Make publishers; what never changes is published at once."""
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
        self._static = make(TFMessage, "/tf_static", LATCHED)
        fixed = TransformStamped(child_frame_id=self._odom)
        fixed.header.frame_id = "map"
        self._static.publish(TFMessage(transforms=[*self._transforms.fixed, fixed]))
        self._description = make(String, "robot_description", LATCHED)
        self._description.publish(String(data=tree.urdf))
        self._said: dict[str, Any] = {}
        self._told_mode: tuple[Any, int] = (None, 0)

    def tick(self, nanoseconds: int) -> None:
        """Robot time, as far as it is known."""
        if self._clock is not None:
            seconds, rest = divmod(nanoseconds, 10**9)
            self._clock.publish(Clock(clock=Time(sec=seconds, nanosec=rest)))

    def publish(self, state: RobotState) -> None:
        """A state that is newer than all before; every header has the robot time that it was so."""
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
        if told != self._told_mode[0] or state.clock - self._told_mode[1] >= MODE_AGAIN:
            self._told_mode = (told, state.clock)
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
        if self._said.get(publisher.topic_name) != message:
            self._said[publisher.topic_name] = message
            publisher.publish(message)


def motion_state(state: RobotState) -> MotionState:
    """What is known of it here; numbers that the link does not carry are NaN, −1 or missing."""
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
