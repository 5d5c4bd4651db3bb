"""State of the robot, under ViGIR's and the standard names. Messages are serialized once (``prepared_message``)."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import nan
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, PoseStamped, Quaternion, TransformStamped, Vector3, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, Imu, JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from valor.common.arrays import FloatArray
from valor.common.messages import Proprioceptor
from valor.common.rotation import conjugate, rotate
from valor.devices.kvh import DENSITIES
from valor.robot.batteries import Batteries
from valor.robot.description import RobotDescription
from valor.robot.kinematic_tree import KinematicTree
from valor.robot.tables import SensorNoise
from valor.ros.limbs import FEET, HANDS, WRENCH
from valor.ros.parameters import Parameters
from valor.ros.prepared_message import PreparedPublisher, mark, stamp_mark
from valor.ros.transforms import ODOM, TransformPublisher
from valor.valor_ros_controller.ros.node import LATCHED
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

QUEUE = 5
"""Depth of reliable state topics; old states are dropped."""


@dataclass(frozen=True)
class Publication:
    """State with topics and rate."""

    topics: tuple[str, ...]
    rate: float  # [Hz]; at most the update rate


PUBLICATIONS: Mapping[str, Publication] = {
    "clock": Publication(("clock",), 250.0),  # in simulation
    "joints": Publication(("joint_states",), 250.0),
    "imu": Publication(("imu/data",), 250.0),
    "kvh": Publication(("imu/kvh/data_raw",), 250.0),  # by REP-145: without an attitude
    "wrenches": Publication(tuple(WRENCH.format(limb) for limb in FEET + HANDS), 125.0),
    "pelvis": Publication(("flor/state/pelvis_pose_world", "odom"), 125.0),
    "transforms": Publication(("/tf",), 50.0),
    "battery": Publication(("battery_state",), 1.0),
}


def _diagonal(variances: Iterable[float]) -> FloatArray:
    """Row-major diagonal covariance."""
    return np.diag(list(variances)).ravel()


def _stamped(kind: type[Any], frame: str, **fields: object) -> Any:
    message = kind(**fields)
    message.header.stamp, message.header.frame_id = stamp_mark(), frame
    return message


def _mark_vector(vector: Vector3 | Point, first: int) -> None:
    vector.x, vector.y, vector.z = map(mark, range(first, first + 3))


def _mark_quaternion(q: Quaternion, first: int) -> None:
    """Mark w, x, y, z in this order."""
    q.w, q.x, q.y, q.z = map(mark, range(first, first + 4))


def _joint_states(robot: RobotDescription) -> JointState:
    n = len(robot.joints)
    message = _stamped(JointState, "", name=list(robot.joints))
    message.position, message.velocity, message.effort = ([mark(n * i + j) for j in range(n)] for i in range(3))
    return message


def _imu(frame: str, noise: SensorNoise) -> Imu:
    message = _stamped(Imu, frame)
    _mark_quaternion(message.orientation, 0)
    _mark_vector(message.angular_velocity, 4)
    _mark_vector(message.linear_acceleration, 7)
    message.orientation_covariance = _diagonal((noise.orientation**2,) * 3)
    message.angular_velocity_covariance = _diagonal((noise.gyroscope**2,) * 3)
    message.linear_acceleration_covariance = _diagonal((noise.accelerometer**2,) * 3)
    return message


def _kvh(frame: str, rate: float) -> Imu:
    """``rate``: of the samples [Hz]. Its orientation is unknown."""
    message = _stamped(Imu, frame)
    _mark_vector(message.angular_velocity, 0)
    _mark_vector(message.linear_acceleration, 3)
    message.orientation_covariance[0] = -1.0
    gyroscope, accelerometer = (_diagonal((rate * density**2,) * 3) for density in DENSITIES)
    message.angular_velocity_covariance, message.linear_acceleration_covariance = gyroscope, accelerometer
    return message


def _wrench(frame: str) -> WrenchStamped:
    message = _stamped(WrenchStamped, frame)
    _mark_vector(message.wrench.force, 0)
    _mark_vector(message.wrench.torque, 3)
    return message


def _pelvis_pose(frame: str) -> PoseStamped:
    message = _stamped(PoseStamped, frame)
    _mark_vector(message.pose.position, 0)
    _mark_quaternion(message.pose.orientation, 3)
    return message


def _odometry(frame: str, base_frame: str, noise: SensorNoise) -> Odometry:
    """Variances of the estimator are marked; those of the gyroscope are the IMU's."""
    message = _stamped(Odometry, frame, child_frame_id=base_frame)
    message.pose.pose = _pelvis_pose(frame).pose
    _mark_vector(message.twist.twist.linear, 7)
    _mark_vector(message.twist.twist.angular, 10)
    message.pose.covariance = _diagonal(mark(13 + i) for i in range(6))
    message.twist.covariance = _diagonal((*(mark(19 + i) for i in range(3)), *(noise.gyroscope**2,) * 3))
    return message


def _battery(table: Batteries | None) -> BatteryState:
    """All packs together. Known from the start: what robot.yaml states."""
    unknown = dict.fromkeys(("current", "charge", "capacity", "design_capacity", "percentage", "temperature"), nan)
    message = BatteryState(present=True, **unknown)
    if table:
        message.capacity = message.design_capacity = table.whole
        message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
        message.power_supply_technology = BatteryState.POWER_SUPPLY_TECHNOLOGY_LIPO
        message.location = table.location
    return message


def publish_static(node: Node, parameters: Parameters, fixed: Sequence[TransformStamped], odom: str) -> None:
    """Publish ``/tf_static``: ``fixed`` and, by parameter ``publish_map``, the identity ``map`` → ``odom`` (REP 105).

    The names of the topic and of ``map`` are absolute: robots in one domain share them.
    """
    publisher = node.create_publisher(TFMessage, "/tf_static", LATCHED)
    identity = TransformStamped(child_frame_id=odom)
    identity.header.frame_id = "map"

    def publish(with_map: bool) -> None:
        publisher.publish(TFMessage(transforms=[*fixed, identity] if with_map else fixed))

    text = "the identity as map → odom; false where a localiser publishes it"
    publish(parameters.declare("publish_map", True, text, on_change=publish))


class Publisher:
    """Publishes the state of a cycle. Update thread."""

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
        """Create publishers and messages.

        ``stamp``: robot time, updated by its owner; ``rate``: of the update loop [Hz]; ``simulated``: whether to
        publish ``/clock``; ``prefix``: of frames' names.
        """

        def prepared(topic: str, message: object, count: int) -> PreparedPublisher:
            return PreparedPublisher(node, topic, message, count, stamp=stamp, queue=QUEUE)

        tables = robot.tables
        (joints_topic,), (imu_topic,), (kvh_topic,), (pose_topic, odom_topic) = (
            PUBLICATIONS[name].topics for name in ("joints", "imu", "kvh", "pelvis")
        )
        noise = max((profile.noise for profile in tables.actuators.values()), key=lambda noise: noise.gyroscope)
        self._cycle = 0
        node.create_publisher(String, "robot_description", LATCHED).publish(String(data=tree.urdf))
        self._clock = node.create_publisher(Clock, *PUBLICATIONS["clock"].topics, 1) if simulated else None
        self._clock_message = Clock(clock=stamp)
        self._joints = prepared(joints_topic, _joint_states(robot), 3 * len(robot.joints))
        self._joint_vectors = self._joints.values.reshape(3, -1)
        self._imu = prepared(imu_topic, _imu(prefix + tree.frame_of(tables.imu.site), noise), 10)
        self._kvh = None
        if tables.kvh:
            frame = prefix + tree.frame_of(tables.kvh.site)
            self._kvh = prepared(kvh_topic, _kvh(frame, tables.control_rate), 6)
        hands = (hand.site if hand else None for hand in (tables.hands.left, tables.hands.right))
        sites = (tables.feet.left.sole, tables.feet.right.sole, *hands)
        self._wrenches = [
            (prepared(topic, _wrench(prefix + tree.frame_of(site)), 6), f"{side}_{limb}_wrench")
            for topic, site, (limb, side) in zip(
                PUBLICATIONS["wrenches"].topics, sites, product(("foot", "hand"), ("left", "right")), strict=True
            )
            if site is not None
        ]
        self._pose = prepared(pose_topic, _pelvis_pose(prefix + ODOM), 7)
        self._odom = prepared(odom_topic, _odometry(prefix + ODOM, prefix + tree.base_frame, noise), 22)
        self.transforms = TransformPublisher(node, tree, robot, stamp, prefix=prefix)  # publisher of the robot's tf
        self._battery = node.create_publisher(BatteryState, *PUBLICATIONS["battery"].topics, 1)
        self._battery_message, self._batteries = _battery(tables.batteries), tables.batteries
        self._battery_message.header.stamp = stamp
        self._schedule(rate)

    def _schedule(self, rate: float) -> None:
        """Spread publications over cycles; equal rates share cycles, so that stamps match."""
        self._joints_every = max(1, round(rate / PUBLICATIONS["joints"].rate))
        self._due: list[tuple[int, int, Callable[[ValorEscherHWInterface], None]]] = []
        offsets: dict[int, int] = {}  # by number of cycles between publications
        for name, publish in (
            ("imu", self._publish_imu),
            ("kvh", self._publish_kvh),
            ("wrenches", self._publish_wrenches),
            ("pelvis", self._publish_pelvis),
            ("transforms", self._publish_transforms),
            ("battery", self._publish_battery),
        ):
            every = max(1, round(rate / PUBLICATIONS[name].rate))
            offset = offsets.setdefault(every, len(offsets) % every)
            self._due.append((every, offset, publish))

    def publish(self, hw: ValorEscherHWInterface) -> None:
        """Publish what is due in this cycle, after ``publish_measured``."""
        cycle = self._cycle
        self._cycle += 1
        for every, offset, publish in self._due:
            if cycle % every == offset:
                publish(hw)

    def publish_measured(self, hw: ValorEscherHWInterface) -> None:
        """Publish what depends only on the measurement: the clock, before messages with its stamp, and joints."""
        if self._clock:
            self._clock.publish(self._clock_message)
        if self._cycle % self._joints_every:
            return
        measured = _measured(hw)
        vectors = self._joint_vectors
        vectors[0], vectors[1], vectors[2] = measured.joint_position, measured.joint_velocity, measured.joint_effort
        self._joints.publish()

    def _publish_imu(self, hw: ValorEscherHWInterface) -> None:
        measured, values = _measured(hw), self._imu.values
        values[:4] = measured.imu_orientation
        values[4:7] = measured.imu_angular_velocity
        values[7:] = measured.imu_linear_acceleration
        self._imu.publish()

    def _publish_kvh(self, hw: ValorEscherHWInterface) -> None:
        measured = _measured(hw)
        if self._kvh is not None and measured.kvh_angular_velocity.size:
            self._kvh.values[:3] = measured.kvh_angular_velocity
            self._kvh.values[3:] = measured.kvh_linear_acceleration
            self._kvh.publish()

    def _publish_wrenches(self, hw: ValorEscherHWInterface) -> None:
        for publisher, field in self._wrenches:
            publisher.values[:] = getattr(hw.measured, field)
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
        message, table, status = self._battery_message, self._batteries, hw.battery
        message.voltage = _measured(hw).battery_voltage
        if table and status:
            message.voltage, message.current, message.charge = status.voltage, -status.current, status.charge
            message.percentage = share = status.charge / table.whole
            message.cell_voltage = [status.voltage / table.series] * (table.strings * table.series)
            dead = share < table.critical
            message.power_supply_health = (
                BatteryState.POWER_SUPPLY_HEALTH_DEAD if dead else BatteryState.POWER_SUPPLY_HEALTH_GOOD
            )
        self._battery.publish(message)


def _measured(hw: ValorEscherHWInterface) -> Proprioceptor:
    """Latest measurement, present in every cycle."""
    assert hw.measured is not None
    return hw.measured
