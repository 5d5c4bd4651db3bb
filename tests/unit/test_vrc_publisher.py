"""What the VRC publishes of a measurement is that measurement, field by field, as rclpy reads it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import cos, sin
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.serialization import deserialize_message

from harness.motion_states import motion_state
from harness.places import ROBOTS
from valor.common.messages import BatteryStatus, MotionState, Proprioceptor
from valor.robot.description import RobotDescription
from valor.robot.kinematic_tree import KinematicTree
from valor.valor_ros_controller.ros.publisher import PUBLICATIONS, Publisher, publish_static
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

ROBOT = RobotDescription.load(ROBOTS / "escher")
N = len(ROBOT.joints)
CYCLES = 250
YAW = 0.6


@dataclass
class Topic:
    """Keeps what was published last, as it would leave the process, and counts."""

    name: str
    kind: type
    order: list[str]  # of all topics' messages
    new: list[Any] = field(default_factory=list)
    count: int = 0

    def get_subscription_count(self) -> int:
        return 1

    def publish(self, message: Any) -> None:
        self.new.append(deserialize_message(message, self.kind) if isinstance(message, bytes) else message)
        self.count += 1
        self.order.append(self.name)


@dataclass
class Topics:
    """In the place of a ROS node."""

    by_name: dict[str, Topic] = field(default_factory=dict)
    order: list[str] = field(default_factory=list)

    def create_publisher(self, kind: type, name: str, _: object) -> Topic:
        return self.by_name.setdefault(name, Topic(name, kind, self.order))

    def new(self, name: str) -> Any | None:
        """What has been published since the last look."""
        sent = self.by_name[name].new
        message = sent[-1] if sent else None
        sent.clear()
        return message


def vector(v: Any) -> tuple[float, ...]:
    return (v.x, v.y, v.z)


def quaternion(q: Any) -> tuple[float, ...]:
    return (q.w, q.x, q.y, q.z)


def same(*pairs: tuple[Sequence[float], Any]) -> None:
    for told, true in pairs:
        np.testing.assert_allclose(told, true, rtol=1e-12)


def check(topics: Topics, sense: Proprioceptor, motion: MotionState) -> None:
    """Everything that was published in a cycle."""
    if (state := topics.new("joint_states")) is not None:
        assert list(state.name) == list(ROBOT.joints)
        same((state.position, sense.joint_position), (state.velocity, sense.joint_velocity))
        same((state.effort, sense.joint_effort))
    if (imu := topics.new("imu/data")) is not None:
        same((quaternion(imu.orientation), sense.imu_orientation))
        same((vector(imu.angular_velocity), sense.imu_angular_velocity))
        same((vector(imu.linear_acceleration), sense.imu_linear_acceleration))
    if (kvh := topics.new("imu/kvh/data_raw")) is not None:
        same((vector(kvh.angular_velocity), sense.kvh_angular_velocity))
        same((vector(kvh.linear_acceleration), sense.kvh_linear_acceleration))
        assert kvh.header.frame_id == "kvh_link" and kvh.orientation_covariance[0] == -1.0, "REP-145"
    if (battery := topics.new("battery_state")) is not None:
        np.testing.assert_allclose((battery.voltage, battery.current, battery.charge), (44.4, -10.0, 9.0), rtol=1e-6)
        assert (battery.capacity, battery.design_capacity, battery.percentage) == (20.0, 20.0, np.float32(0.45))
        assert list(battery.cell_voltage) == [np.float32(3.7)] * 24 and (battery.present, battery.location) == (
            True,
            "chest",
        )
        assert battery.power_supply_technology == battery.POWER_SUPPLY_TECHNOLOGY_LIPO
        assert battery.power_supply_status == battery.POWER_SUPPLY_STATUS_DISCHARGING
        assert battery.power_supply_health == battery.POWER_SUPPLY_HEALTH_GOOD
    for limb, wrench in (
        ("l_foot", sense.left_foot_wrench),
        ("r_foot", sense.right_foot_wrench),
        ("l_hand", sense.left_hand_wrench),
        ("r_hand", sense.right_hand_wrench),
    ):
        if (felt := topics.new(f"flor/{limb}/force_torque_sensor")) is not None:
            same((vector(felt.wrench.force) + vector(felt.wrench.torque), wrench))
    if (pose := topics.new("flor/state/pelvis_pose_world")) is not None:
        same((vector(pose.pose.position), motion.pelvis_position_in_odom))
        same((quaternion(pose.pose.orientation), motion.pelvis_orientation_in_odom))
    if (odom := topics.new("odom")) is not None:
        same((vector(odom.pose.pose.position), motion.pelvis_position_in_odom))
        same((quaternion(odom.pose.pose.orientation), motion.pelvis_orientation_in_odom))
        x, y, z = motion.pelvis_linear_velocity_in_odom
        c, s = cos(YAW), sin(YAW)
        same((vector(odom.twist.twist.linear), (c * x + s * y, c * y - s * x, z)))
        same((vector(odom.twist.twist.angular), motion.pelvis_angular_velocity_in_pelvis))
        pose_covariance, twist_covariance = (m.covariance.reshape(6, 6) for m in (odom.pose, odom.twist))
        variance = np.concatenate((motion.pelvis_position_variance, motion.pelvis_orientation_variance))
        same((pose_covariance, np.diag(variance)))
        same((twist_covariance.diagonal()[:3], motion.pelvis_linear_velocity_variance))
        assert np.count_nonzero(twist_covariance) == 6


def test_every_number_stands_where_it_belongs_and_comes_at_its_rate() -> None:
    topics, stamp, random = Topics(), Time(), np.random.default_rng(0)
    publisher = Publisher(topics, ROBOT, KinematicTree.load(ROBOT), stamp, rate=250.0, simulated=True)
    hw = ValorEscherHWInterface(ROBOT)
    some = random.standard_normal
    for cycle in range(CYCLES):
        stamp.sec, stamp.nanosec = cycle, 7 * cycle
        joints, inertia, wrenches = (some((count, size)) for count, size in ((3, N), (4, 3), (4, 6)))
        hw.measured = sense = Proprioceptor(1, 1, 1, *joints, some(4), *inertia, *wrenches, 47.5, "stand")  # type: ignore[call-arg]
        hw.battery = BatteryStatus(cycle, 44.4, 10.0, 9.0)
        hw.motion = motion = motion_state(
            heading=YAW,
            pelvis_position_in_odom=some(3),
            pelvis_linear_velocity_in_odom=some(3),
            pelvis_angular_velocity_in_pelvis=some(3),
            pelvis_position_variance=some(3) ** 2,
            pelvis_orientation_variance=some(3) ** 2,
            pelvis_linear_velocity_variance=some(3) ** 2,
        )
        topics.order.clear()
        publisher.publish_measured(hw)
        publisher.publish(hw)
        assert topics.order[0] == "clock", "a stamp that the clock has not come to"
        joined = [
            name for publication in PUBLICATIONS.values() if publication.rate == 125.0 for name in publication.topics
        ]
        assert len(set(joined).intersection(topics.order)) in (0, len(joined)), "stamps that are not to be matched"
        for name, topic in topics.by_name.items():
            for message in topic.new if name != "robot_description" else ():
                if header := getattr(message, "header", None):
                    assert (header.stamp.sec, header.stamp.nanosec) == (cycle, 7 * cycle), name
        check(topics, sense, motion)
    for publication in PUBLICATIONS.values():
        for name in publication.topics:
            assert topics.by_name[name].count == pytest.approx(publication.rate * CYCLES / 250.0, abs=1), name


@pytest.mark.parametrize("at_start", [True, False])
def test_map_is_published_as_the_parameter_says(at_start: bool) -> None:
    fixed = TransformStamped(child_frame_id="escher1/base_link")
    topics, parameters = Topics(), Mock()
    parameters.declare.return_value = at_start
    publish_static(topics, parameters, [fixed], "escher1/odom")
    for with_map in (at_start, not at_start):
        message: Any = topics.new("/tf_static")
        links = [(each.header.frame_id, each.child_frame_id) for each in message.transforms]
        assert links == [("", "escher1/base_link")] + [("map", "escher1/odom")] * with_map
        parameters.declare.call_args.kwargs["on_change"](not at_start)
