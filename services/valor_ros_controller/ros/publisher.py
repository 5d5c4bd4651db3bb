"""The robot's state on ROS, in ViGIR's and the standard names.

Messages are serialized once and their numbers written anew (``prepared_message``). How often each is published is
decided by ``PUBLICATIONS``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import nan

import numpy as np
from builtin_interfaces.msg import Time
from control_msgs.msg import DynamicJointState, InterfaceValue
from geometry_msgs.msg import Point, PoseStamped, Quaternion, Vector3, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, Imu, JointState
from std_msgs.msg import String

from valor.common.arrays import FloatArray
from valor.common.messages import Proprioceptor
from valor.common.rotation import conjugate, rotate
from valor.robot.description import RobotDescription
from valor.robot.kinematic_tree import KinematicTree
from valor.robot.tables import SensorNoise
from valor.ros.limbs import FEET, HANDS, WRENCH
from valor.ros.prepared_message import PreparedPublisher, mark, stamp_mark
from valor.ros.transforms import ODOM, TransformPublisher
from valor.valor_ros_controller.ros.node import LATCHED
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

STATE_INTERFACES = ("position", "velocity", "effort")
"""Of every joint."""
QUEUE = 5
"""Depth of the state topics: reliable for whoever asks for it, but old states are let go."""


@dataclass(frozen=True)
class Publication:
    """One line of the table."""

    name: str
    topics: tuple[str, ...]
    rate: float  # [Hz]; at most the update rate


PUBLICATIONS: tuple[Publication, ...] = (
    Publication("clock", ("clock",), 250.0),  # in simulation
    Publication("joints", ("joint_states",), 250.0),
    # What joint_states has, at three times the length: for tools that know nothing else.
    Publication("interfaces", ("dynamic_joint_states",), 50.0),
    Publication("imu", ("imu/data",), 250.0),
    Publication("feet", tuple(WRENCH.format(foot) for foot in FEET), 125.0),
    Publication("hands", tuple(WRENCH.format(hand) for hand in HANDS), 125.0),
    Publication("pelvis", ("flor/state/pelvis_pose_world", "odom"), 125.0),
    Publication("transforms", ("/tf",), 50.0),
    Publication("battery", ("battery_state",), 1.0),
)
RATES = {publication.name: publication.rate for publication in PUBLICATIONS}
TOPICS = {publication.name: publication.topics for publication in PUBLICATIONS}


def _diagonal(variances: Iterable[float]) -> FloatArray:
    """Row-major covariance."""
    return np.diag(list(variances)).ravel()


def _mark_vector(vector: Vector3 | Point, first: int) -> None:
    vector.x, vector.y, vector.z = map(mark, range(first, first + 3))


def _mark_quaternion(q: Quaternion, first: int) -> None:
    """In our order: w, x, y, z."""
    q.w, q.x, q.y, q.z = map(mark, range(first, first + 4))


def _joint_states(robot: RobotDescription) -> JointState:
    n = len(robot.joints)
    message = JointState(name=list(robot.joints))
    message.header.stamp = stamp_mark()
    message.position, message.velocity, message.effort = ([mark(n * i + j) for j in range(n)] for i in range(3))
    return message


def _interfaces(robot: RobotDescription) -> DynamicJointState:
    """As ros2_control's joint_state_broadcaster tells them; the marks are those of ``_joint_states``."""
    n = len(robot.joints)
    message = DynamicJointState(joint_names=list(robot.joints))
    message.header.stamp = stamp_mark()
    message.interface_values = [
        InterfaceValue(interface_names=STATE_INTERFACES, values=[mark(n * i + j) for i in range(len(STATE_INTERFACES))])
        for j in range(n)
    ]
    return message


def _imu(frame: str, noise: SensorNoise) -> Imu:
    message = Imu()
    message.header.stamp, message.header.frame_id = stamp_mark(), frame
    _mark_quaternion(message.orientation, 0)
    _mark_vector(message.angular_velocity, 4)
    _mark_vector(message.linear_acceleration, 7)
    message.orientation_covariance = _diagonal((noise.orientation**2,) * 3)
    message.angular_velocity_covariance = _diagonal((noise.gyroscope**2,) * 3)
    message.linear_acceleration_covariance = _diagonal((noise.accelerometer**2,) * 3)
    return message


def _wrench(frame: str) -> WrenchStamped:
    message = WrenchStamped()
    message.header.stamp, message.header.frame_id = stamp_mark(), frame
    _mark_vector(message.wrench.force, 0)
    _mark_vector(message.wrench.torque, 3)
    return message


def _pelvis_pose(frame: str) -> PoseStamped:
    message = PoseStamped()
    message.header.stamp, message.header.frame_id = stamp_mark(), frame
    _mark_vector(message.pose.position, 0)
    _mark_quaternion(message.pose.orientation, 3)
    return message


def _odometry(frame: str, base_frame: str, noise: SensorNoise) -> Odometry:
    """The Motion Manager's estimator says how sure it is; the gyroscope's noise is the IMU's."""
    message = Odometry(child_frame_id=base_frame)
    message.header.stamp, message.header.frame_id = stamp_mark(), frame
    message.pose.pose = _pelvis_pose(frame).pose
    _mark_vector(message.twist.twist.linear, 7)
    _mark_vector(message.twist.twist.angular, 10)
    message.pose.covariance = _diagonal(mark(13 + i) for i in range(6))
    message.twist.covariance = _diagonal((*(mark(19 + i) for i in range(3)), *(noise.gyroscope**2,) * 3))
    return message


class Publisher:
    """Publishes a cycle's state. Used from the update thread alone.

    Attributes:
        transforms: of the robot.
    """

    def __init__(
        self,
        node: Node,
        robot: RobotDescription,
        tree: KinematicTree,
        stamp: Time,
        *,
        rate: float,
        simulated: bool,
        prefix: str = "",
    ) -> None:
        """Make publishers and messages.

        Args:
            node: the ROS node.
            robot: its description.
            tree: links and frames.
            stamp: robot time, shared by all headers and kept up to date by its owner.
            rate: of the update loop [Hz].
            simulated: whether robot time is to be everybody's clock.
            prefix: of frames' names.
        """

        def prepared(topic: str, message: object, count: int) -> PreparedPublisher:
            return PreparedPublisher(node, [topic], message, count, stamp=stamp, queue=QUEUE)

        def wrenches(name: str, sites: list[str] | list[str | None]) -> list[PreparedPublisher | None]:
            return [
                None if site is None else prepared(topic, _wrench(prefix + tree.frame_of(site)), 6)
                for topic, site in zip(TOPICS[name], sites, strict=True)
            ]

        tables = robot.tables
        (joints_topic,), (interfaces_topic,), (imu_topic,), (pose_topic, odom_topic) = (
            TOPICS[name] for name in ("joints", "interfaces", "imu", "pelvis")
        )
        noise = max((profile.noise for profile in tables.actuators.values()), key=lambda noise: noise.gyroscope)
        self._cycle = 0
        node.create_publisher(String, "robot_description", LATCHED).publish(String(data=tree.urdf))
        self._clock = node.create_publisher(Clock, *TOPICS["clock"], 1) if simulated else None
        self._clock_message = Clock(clock=stamp)
        self._joints = prepared(joints_topic, _joint_states(robot), 3 * len(robot.joints))
        self._joint_vectors = self._joints.values.reshape(3, -1)
        self._interfaces = prepared(interfaces_topic, _interfaces(robot), 3 * len(robot.joints))
        self._imu = prepared(imu_topic, _imu(prefix + tree.frame_of(tables.imu.site), noise), 10)
        self._feet = wrenches("feet", [tables.feet.left.sole, tables.feet.right.sole])
        hands = (tables.hands.left, tables.hands.right)
        self._hands = wrenches("hands", [None if hand is None else hand.site for hand in hands])
        self._pose = prepared(pose_topic, _pelvis_pose(prefix + ODOM), 7)
        self._odom = prepared(odom_topic, _odometry(prefix + ODOM, prefix + tree.base_frame, noise), 22)
        self.transforms = TransformPublisher(node, tree, robot, stamp, prefix=prefix)
        self._battery = node.create_publisher(BatteryState, *TOPICS["battery"], 1)
        unknown = dict.fromkeys(("current", "charge", "capacity", "design_capacity", "percentage", "temperature"), nan)
        self._battery_message = BatteryState(present=True, **unknown)
        self._battery_message.header.stamp = stamp
        self._schedule(rate)

    def _schedule(self, rate: float) -> None:
        """Spread the work over cycles; what comes equally often comes together, to be matched by its stamps."""
        self._joints_every = max(1, round(rate / RATES["joints"]))
        self._due: list[tuple[int, int, Callable[[ValorEscherHWInterface], None]]] = []
        offsets: dict[int, int] = {}  # of what comes in every so many cycles
        for name, publish in (
            ("imu", self._publish_imu),
            ("feet", self._publish_feet),
            ("hands", self._publish_hands),
            ("pelvis", self._publish_pelvis),
            ("transforms", self._publish_transforms),
            ("interfaces", self._publish_interfaces),
            ("battery", self._publish_battery),
        ):
            every = max(1, round(rate / RATES[name]))
            offset = offsets.setdefault(every, len(offsets) % every)
            self._due.append((every, offset, publish))

    def publish(self, hw: ValorEscherHWInterface) -> None:
        """Publish what else is due in this cycle."""
        cycle = self._cycle
        self._cycle += 1
        for every, offset, publish in self._due:
            if cycle % every == offset:
                publish(hw)

    def publish_measured(self, hw: ValorEscherHWInterface) -> None:
        """Publish what waits for nothing but the measurement: the clock, before all that bears its stamp, and joints.

        Before ``publish``; robot time is in the stamp already.
        """
        if self._clock:
            self._clock.publish(self._clock_message)
        if self._cycle % self._joints_every:
            return
        measured = _measured(hw)
        vectors = self._joint_vectors
        vectors[0], vectors[1], vectors[2] = measured.joint_position, measured.joint_velocity, measured.joint_effort
        self._joints.publish()

    def _publish_interfaces(self, hw: ValorEscherHWInterface) -> None:
        if not self._interfaces.heard:
            return
        measured = _measured(hw)
        values = (measured.joint_position, measured.joint_velocity, measured.joint_effort)
        self._interfaces.values[:] = np.concatenate(values)
        self._interfaces.publish()

    def _publish_imu(self, hw: ValorEscherHWInterface) -> None:
        measured, values = _measured(hw), self._imu.values
        values[:4] = measured.imu_orientation
        values[4:7] = measured.imu_angular_velocity
        values[7:] = measured.imu_linear_acceleration
        self._imu.publish()

    def _publish_feet(self, hw: ValorEscherHWInterface) -> None:
        measured = _measured(hw)
        self._publish_wrenches(self._feet, measured.left_foot_wrench, measured.right_foot_wrench)

    def _publish_hands(self, hw: ValorEscherHWInterface) -> None:
        measured = _measured(hw)
        self._publish_wrenches(self._hands, measured.left_hand_wrench, measured.right_hand_wrench)

    @staticmethod
    def _publish_wrenches(publishers: list[PreparedPublisher | None], *wrenches: FloatArray) -> None:
        for publisher, wrench in zip(publishers, wrenches, strict=True):
            if publisher is not None:
                publisher.values[:] = wrench
                publisher.publish()

    def _publish_pelvis(self, hw: ValorEscherHWInterface) -> None:
        motion = hw.motion
        if motion is None:
            return
        pose, odom = self._pose.values, self._odom.values
        odom[:3] = motion.pelvis_position_in_odom
        odom[3:7] = motion.pelvis_orientation_in_odom
        pose[:] = odom[:7]
        self._pose.publish()
        into_pelvis = conjugate(motion.pelvis_orientation_in_odom.tolist())
        odom[7:10] = rotate(into_pelvis, motion.pelvis_linear_velocity_in_odom.tolist())  # the twist is the child's
        odom[10:13] = motion.pelvis_angular_velocity_in_pelvis
        odom[13:16] = motion.pelvis_position_variance
        odom[16:19] = motion.pelvis_orientation_variance
        odom[19:] = motion.pelvis_linear_velocity_variance
        self._odom.publish()

    def _publish_transforms(self, hw: ValorEscherHWInterface) -> None:
        if (motion := hw.motion) is not None:
            pose = motion.pelvis_position_in_odom, motion.pelvis_orientation_in_odom
            self.transforms.publish(hw.position, *pose)

    def _publish_battery(self, hw: ValorEscherHWInterface) -> None:
        self._battery_message.voltage = _measured(hw).battery_voltage
        self._battery.publish(self._battery_message)


def _measured(hw: ValorEscherHWInterface) -> Proprioceptor:
    """The newest measurement; a cycle is run only when there is one."""
    assert hw.measured is not None
    return hw.measured
