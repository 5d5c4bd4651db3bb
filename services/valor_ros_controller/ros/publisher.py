"""The robot's state on ROS, in ViGIR's and the standard names.

Messages are made once and filled anew; vectors are written into the arrays that the messages hold. What a message
holds at the standard rate is decided by ``PUBLICATIONS``.
"""

from __future__ import annotations

import array
from collections.abc import Callable
from dataclasses import dataclass
from math import nan
from typing import Any

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, PoseWithCovariance, TwistWithCovariance, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, Imu, JointState
from std_msgs.msg import String

from valor_common.messages import Proprioceptor
from valor_common.robot import RobotDescription
from valor_ros_controller.kinematic_tree import KinematicTree
from valor_ros_controller.ros.transforms import ODOM, TransformPublisher
from valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

Vector = npt.NDArray[np.float64]

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


def _diagonal(variances: tuple[float, ...]) -> Vector:
    """Row-major covariance."""
    return np.diag(variances).ravel()


def _diagonal_view(message: PoseWithCovariance | TwistWithCovariance) -> Vector:
    """(6,) the diagonal of a message's covariance, to write to."""
    view: Vector = message.covariance[::7]
    return view


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

        self._joints = node.create_publisher(JointState, *TOPICS["joints"], QUEUE)
        self._joint_message = JointState(name=list(robot.joints))
        self._joint_message.header.stamp = stamp
        self._joint_vectors = []
        for field in ("position", "velocity", "effort"):
            values = array.array("d", bytes(8 * len(robot.joints)))
            setattr(self._joint_message, field, values)
            self._joint_vectors.append(np.frombuffer(getattr(self._joint_message, field)))

        self._imu = node.create_publisher(Imu, *TOPICS["imu"], QUEUE)
        self._imu_message = Imu()
        self._imu_message.header.stamp = stamp
        self._imu_message.header.frame_id = tree.frame_of(tables.imu.site)
        noise = max((profile.noise for profile in tables.actuators.values()), key=lambda noise: noise.gyroscope)
        for field, deviation in (
            ("orientation_covariance", noise.orientation),
            ("angular_velocity_covariance", noise.gyroscope),
            ("linear_acceleration_covariance", noise.accelerometer),
        ):
            setattr(self._imu_message, field, _diagonal((deviation**2,) * 3))

        self._feet = self._wrenches(node, "feet", stamp, tree, (tables.feet.left.sole, tables.feet.right.sole))
        self._hands = self._wrenches(node, "hands", stamp, tree, (tables.hands.left.site, tables.hands.right.site))

        pose_topic, odom_topic = TOPICS["pelvis"]
        self._pose = node.create_publisher(PoseStamped, pose_topic, QUEUE)
        self._pose_message = PoseStamped()
        self._pose_message.header.stamp = stamp
        self._pose_message.header.frame_id = ODOM
        self._odom = node.create_publisher(Odometry, odom_topic, QUEUE)
        self._odom_message = Odometry(child_frame_id=tree.base_frame)
        self._odom_message.header.stamp = stamp
        self._odom_message.header.frame_id = ODOM
        self._odom_message.pose.pose = self._pose_message.pose
        # The Motion Manager's estimator says how sure it is; the gyroscope's noise is the IMU's.
        self._pose_variance = _diagonal_view(self._odom_message.pose)
        self._twist_variance = _diagonal_view(self._odom_message.twist)
        self._twist_variance[3:] = noise.gyroscope**2

        self._battery = node.create_publisher(BatteryState, *TOPICS["battery"], 1)
        unknown = dict.fromkeys(("current", "charge", "capacity", "design_capacity", "percentage", "temperature"), nan)
        self._battery_message = BatteryState(present=True, **unknown)
        self._battery_message.header.stamp = stamp

        # Work is spread over cycles: the n-th of these begins in the n-th cycle.
        self._due: list[tuple[int, int, Callable[[ValorEscherHWInterface], None]]] = []
        for offset, (name, publish) in enumerate(
            (
                ("joints", self._publish_joints),
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
        node: Node, name: str, stamp: Time, tree: KinematicTree, sites: tuple[str, str]
    ) -> list[tuple[Any, WrenchStamped]]:
        pairs = []
        for topic, site in zip(TOPICS[name], sites, strict=True):
            message = WrenchStamped()
            message.header.stamp = stamp
            message.header.frame_id = tree.frame_of(site)
            pairs.append((node.create_publisher(WrenchStamped, topic, QUEUE), message))
        return pairs

    def publish(self, hw: ValorEscherHWInterface) -> None:
        """Publish what is due in this cycle. Robot time is in the stamp already."""
        if self._clock:
            self._clock.publish(self._clock_message)
        cycle = self._cycle
        self._cycle += 1
        for every, offset, publish in self._due:
            if cycle % every == offset:
                publish(hw)

    def _publish_joints(self, hw: ValorEscherHWInterface) -> None:
        measured = _measured(hw)
        position, velocity, effort = self._joint_vectors
        position[:] = measured.joint_position
        velocity[:] = measured.joint_velocity
        effort[:] = measured.joint_effort
        self._joints.publish(self._joint_message)

    def _publish_imu(self, hw: ValorEscherHWInterface) -> None:
        measured, message = _measured(hw), self._imu_message
        q, w, a = message.orientation, message.angular_velocity, message.linear_acceleration
        q.w, q.x, q.y, q.z = measured.imu_orientation.tolist()
        w.x, w.y, w.z = measured.imu_angular_velocity.tolist()
        a.x, a.y, a.z = measured.imu_linear_acceleration.tolist()
        self._imu.publish(message)

    def _publish_feet(self, hw: ValorEscherHWInterface) -> None:
        measured = _measured(hw)
        self._publish_wrenches(self._feet, measured.left_foot_wrench, measured.right_foot_wrench)

    def _publish_hands(self, hw: ValorEscherHWInterface) -> None:
        measured = _measured(hw)
        self._publish_wrenches(self._hands, measured.left_hand_wrench, measured.right_hand_wrench)

    @staticmethod
    def _publish_wrenches(pairs: list[tuple[Any, WrenchStamped]], left: Vector, right: Vector) -> None:
        for (publisher, message), wrench in zip(pairs, (left, right), strict=True):
            force, torque = message.wrench.force, message.wrench.torque
            force.x, force.y, force.z, torque.x, torque.y, torque.z = wrench.tolist()
            publisher.publish(message)

    def _publish_pelvis(self, hw: ValorEscherHWInterface) -> None:
        motion = hw.motion
        if motion is None:
            return
        position, orientation = self._pose_message.pose.position, self._pose_message.pose.orientation
        position.x, position.y, position.z = motion.pelvis_position_in_odom.tolist()
        orientation.w, orientation.x, orientation.y, orientation.z = motion.pelvis_orientation_in_odom.tolist()
        self._pose.publish(self._pose_message)
        twist = self._odom_message.twist.twist
        linear = _into(motion.pelvis_orientation_in_odom, motion.pelvis_linear_velocity_in_odom)
        twist.linear.x, twist.linear.y, twist.linear.z = linear
        twist.angular.x, twist.angular.y, twist.angular.z = motion.pelvis_angular_velocity_in_pelvis.tolist()
        self._pose_variance[:3] = motion.pelvis_position_variance
        self._pose_variance[3:] = motion.pelvis_orientation_variance
        self._twist_variance[:3] = motion.pelvis_linear_velocity_variance
        self._odom.publish(self._odom_message)

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


def _into(orientation: Vector, vector: Vector) -> tuple[float, float, float]:
    """A vector (3,) of the outer frame in the frame that ``orientation`` turns: Odometry's twist is the child's."""
    w, x, y, z = orientation.tolist()
    a, b, c = vector.tolist()
    tx, ty, tz = 2 * (z * b - y * c), 2 * (x * c - z * a), 2 * (y * a - x * b)
    return (
        a + w * tx - (y * tz - z * ty),
        b + w * ty - (z * tx - x * tz),
        c + w * tz - (x * ty - y * tx),
    )
