"""The robot's state on ROS, in ViGIR's and the standard names.

Messages are serialized once and their numbers written anew (``prepared_message``). How often each is published is
decided by ``PUBLICATIONS``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import nan
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, PoseStamped, Quaternion, Vector3, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, Imu, JointState
from std_msgs.msg import String

from valor.common.arrays import FloatArray
from valor.common.messages import Proprioceptor
from valor.robot.description import RobotDescription
from valor.valor_ros_controller.kinematic_tree import KinematicTree
from valor.valor_ros_controller.ros.prepared_message import PreparedMessage, mark, stamp_mark
from valor.valor_ros_controller.ros.transforms import ODOM, TransformPublisher
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

QUEUE = 5
"""Depth of the state topics: reliable for whoever asks for it, but old states are let go."""


@dataclass(frozen=True)
class Publication:
    """One line of the table."""

    name: str
    topics: tuple[str, ...]
    rate: float  # [Hz]; at most the update rate


PUBLICATIONS: tuple[Publication, ...] = (
    Publication("clock", ("/clock",), 250.0),  # in simulation
    Publication("joints", ("/joint_states",), 250.0),
    Publication("imu", ("/imu/data",), 250.0),
    Publication("feet", ("/flor/l_foot/force_torque_sensor", "/flor/r_foot/force_torque_sensor"), 125.0),
    Publication("hands", ("/flor/l_hand/force_torque_sensor", "/flor/r_hand/force_torque_sensor"), 125.0),
    Publication("pelvis", ("/flor/state/pelvis_pose_world", "/odom"), 125.0),
    Publication("transforms", ("/tf",), 50.0),
    Publication("battery", ("/battery_state",), 1.0),
)
RATES = {publication.name: publication.rate for publication in PUBLICATIONS}
TOPICS = {publication.name: publication.topics for publication in PUBLICATIONS}


def _diagonal(variances: tuple[float, ...]) -> FloatArray:
    """Row-major covariance."""
    return np.diag(variances).ravel()


def _mark_vector(vector: Vector3 | Point, first: int) -> None:
    vector.x, vector.y, vector.z = map(mark, range(first, first + 3))


def _mark_quaternion(q: Quaternion, first: int) -> None:
    """In our order: w, x, y, z."""
    q.w, q.x, q.y, q.z = map(mark, range(first, first + 4))


class Publisher:
    """Publishes a cycle's state. Used from the update thread alone."""

    def __init__(
        self, node: Node, robot: RobotDescription, tree: KinematicTree, stamp: Time, *, rate: float, simulated: bool
    ) -> None:
        """Make publishers and messages.

        Args:
            node: the ROS node.
            robot: its description.
            tree: links and frames.
            stamp: robot time, shared by all headers and kept up to date by its owner.
            rate: of the update loop [Hz].
            simulated: whether robot time is to be everybody's clock.
        """
        self._stamp = stamp
        self._cycle = 0
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._description = node.create_publisher(String, "/robot_description", latched)
        self._description.publish(String(data=tree.urdf))
        self._transforms = TransformPublisher(node, tree, robot, stamp)
        tables = robot.tables

        self._clock = node.create_publisher(Clock, *TOPICS["clock"], 1) if simulated else None
        self._clock_message = Clock(clock=stamp)

        n = len(robot.joints)
        self._joints = node.create_publisher(JointState, *TOPICS["joints"], QUEUE)
        joints = JointState(name=list(robot.joints))
        joints.header.stamp = stamp_mark()
        joints.position, joints.velocity, joints.effort = ([mark(n * i + j) for j in range(n)] for i in range(3))
        self._joint_message = PreparedMessage(joints, 3 * n)
        self._joint_vectors = self._joint_message.values.reshape(3, n)

        self._imu = node.create_publisher(Imu, *TOPICS["imu"], QUEUE)
        imu = Imu()
        imu.header.stamp, imu.header.frame_id = stamp_mark(), tree.frame_of(tables.imu.site)
        _mark_quaternion(imu.orientation, 0)
        _mark_vector(imu.angular_velocity, 4)
        _mark_vector(imu.linear_acceleration, 7)
        noise = max((profile.noise for profile in tables.actuators.values()), key=lambda noise: noise.gyroscope)
        for field, deviation in (
            ("orientation_covariance", noise.orientation),
            ("angular_velocity_covariance", noise.gyroscope),
            ("linear_acceleration_covariance", noise.accelerometer),
        ):
            setattr(imu, field, _diagonal((deviation**2,) * 3))
        self._imu_message = PreparedMessage(imu, 10)

        self._feet = self._wrenches(node, "feet", tree, (tables.feet.left.sole, tables.feet.right.sole))
        self._hands = self._wrenches(node, "hands", tree, (tables.hands.left.site, tables.hands.right.site))

        pose_topic, odom_topic = TOPICS["pelvis"]
        self._pose = node.create_publisher(PoseStamped, pose_topic, QUEUE)
        pose = PoseStamped()
        pose.header.stamp, pose.header.frame_id = stamp_mark(), ODOM
        _mark_vector(pose.pose.position, 0)
        _mark_quaternion(pose.pose.orientation, 3)
        self._pose_message = PreparedMessage(pose, 7)
        self._odom = node.create_publisher(Odometry, odom_topic, QUEUE)
        odom = Odometry(child_frame_id=tree.base_frame)
        odom.header.stamp, odom.header.frame_id = stamp_mark(), ODOM
        odom.pose.pose = pose.pose
        _mark_vector(odom.twist.twist.linear, 7)
        _mark_vector(odom.twist.twist.angular, 10)
        # The Motion Manager's estimator says how sure it is; the gyroscope's noise is the IMU's.
        odom.pose.covariance = np.diag([mark(13 + i) for i in range(6)]).ravel()
        odom.twist.covariance = _diagonal((*(mark(19 + i) for i in range(3)), *(noise.gyroscope**2,) * 3))
        self._odom_message = PreparedMessage(odom, 22)

        self._battery = node.create_publisher(BatteryState, *TOPICS["battery"], 1)
        unknown = dict.fromkeys(("current", "charge", "capacity", "design_capacity", "percentage", "temperature"), nan)
        self._battery_message = BatteryState(present=True, **unknown)
        self._battery_message.header.stamp = stamp

        # Work is spread over cycles: the n-th of these begins in the n-th cycle.
        self._joints_every = max(1, round(rate / RATES["joints"]))
        self._due: list[tuple[int, int, Callable[[ValorEscherHWInterface], None]]] = []
        for offset, (name, publish) in enumerate(
            (
                ("imu", self._publish_imu),
                ("feet", self._publish_feet),
                ("hands", self._publish_hands),
                ("pelvis", self._publish_pelvis),
                ("transforms", self._publish_transforms),
                ("battery", self._publish_battery),
            )
        ):
            every = max(1, round(rate / RATES[name]))
            self._due.append((every, offset % every, publish))

    @staticmethod
    def _wrenches(
        node: Node, name: str, tree: KinematicTree, sites: tuple[str, str]
    ) -> list[tuple[Any, PreparedMessage]]:
        pairs = []
        for topic, site in zip(TOPICS[name], sites, strict=True):
            message = WrenchStamped()
            message.header.stamp, message.header.frame_id = stamp_mark(), tree.frame_of(site)
            _mark_vector(message.wrench.force, 0)
            _mark_vector(message.wrench.torque, 3)
            pairs.append((node.create_publisher(WrenchStamped, topic, QUEUE), PreparedMessage(message, 6)))
        return pairs

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
        self._joints.publish(self._joint_message.serialized(self._stamp))

    def _publish_imu(self, hw: ValorEscherHWInterface) -> None:
        measured, values = _measured(hw), self._imu_message.values
        values[:4] = measured.imu_orientation
        values[4:7] = measured.imu_angular_velocity
        values[7:] = measured.imu_linear_acceleration
        self._imu.publish(self._imu_message.serialized(self._stamp))

    def _publish_feet(self, hw: ValorEscherHWInterface) -> None:
        measured = _measured(hw)
        self._publish_wrenches(self._feet, measured.left_foot_wrench, measured.right_foot_wrench)

    def _publish_hands(self, hw: ValorEscherHWInterface) -> None:
        measured = _measured(hw)
        self._publish_wrenches(self._hands, measured.left_hand_wrench, measured.right_hand_wrench)

    def _publish_wrenches(self, pairs: list[tuple[Any, PreparedMessage]], left: FloatArray, right: FloatArray) -> None:
        for (publisher, message), wrench in zip(pairs, (left, right), strict=True):
            message.values[:] = wrench
            publisher.publish(message.serialized(self._stamp))

    def _publish_pelvis(self, hw: ValorEscherHWInterface) -> None:
        motion = hw.motion
        if motion is None:
            return
        pose, odom = self._pose_message.values, self._odom_message.values
        odom[:3] = motion.pelvis_position_in_odom
        odom[3:7] = motion.pelvis_orientation_in_odom
        pose[:] = odom[:7]
        self._pose.publish(self._pose_message.serialized(self._stamp))
        odom[7:10] = _into(motion.pelvis_orientation_in_odom, motion.pelvis_linear_velocity_in_odom)
        odom[10:13] = motion.pelvis_angular_velocity_in_pelvis
        odom[13:16] = motion.pelvis_position_variance
        odom[16:19] = motion.pelvis_orientation_variance
        odom[19:] = motion.pelvis_linear_velocity_variance
        self._odom.publish(self._odom_message.serialized(self._stamp))

    def _publish_transforms(self, hw: ValorEscherHWInterface) -> None:
        if hw.motion is not None:
            self._transforms.publish(hw.position, hw.motion)

    def _publish_battery(self, hw: ValorEscherHWInterface) -> None:
        self._battery_message.voltage = _measured(hw).battery_voltage
        self._battery.publish(self._battery_message)


def _measured(hw: ValorEscherHWInterface) -> Proprioceptor:
    """The newest measurement; a cycle is run only when there is one."""
    assert hw.measured is not None
    return hw.measured


def _into(orientation: FloatArray, vector: FloatArray) -> tuple[float, float, float]:
    """A vector (3,) of the outer frame in the frame that ``orientation`` turns: Odometry's twist is the child's."""
    w, x, y, z = orientation.tolist()
    a, b, c = vector.tolist()
    tx, ty, tz = 2 * (z * b - y * c), 2 * (x * c - z * a), 2 * (y * a - x * b)
    return (
        a + w * tx - (y * tz - z * ty),
        b + w * ty - (z * tx - x * tz),
        c + w * tz - (x * ty - y * tx),
    )
