"""What can be plotted: of what the page hears, and of any other message."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import Point32, PolygonStamped
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Imu, JointState

from valor.operator_station.heard import Heard
from valor.operator_station.intake import Intake
from valor.operator_station.listener import Listener
from valor.operator_station.signals import LONGEST, MOST, commanded, numbers_of, position, signals
from valor.operator_station.topics import Topics
from valor.valorctl.ros_domain import reserve

QUIET = 60.0  # [s]


def test_the_numbers_of_a_message_are_named_by_their_fields() -> None:
    message = Imu()
    message.angular_velocity.x, message.header.stamp.sec = 0.5, 7
    message.orientation_covariance = np.arange(9.0)
    found = numbers_of("/imu", message)
    assert found["/imu angular_velocity.x"] == 0.5
    assert found["/imu header.stamp.sec"] == 7.0
    assert found["/imu orientation_covariance[8]"] == 8.0
    assert not any("frame_id" in name for name in found)
    assert found.keys() == numbers_of("/imu", Imu()).keys()


def test_large_messages_are_bounded() -> None:
    long = JointState(name=["x"] * 500, position=[1.0] * 500)
    assert len(numbers_of("/j", long)) == LONGEST + 2
    polygon = PolygonStamped()
    polygon.polygon.points = [Point32(x=1.0)] * 500
    assert len(numbers_of("/p", polygon)) == 2 + 3 * LONGEST <= MOST


def test_tracking_is_offered_where_set_points_are_known() -> None:
    heard = Heard(joints={"knee": 0.5, "hip": 0.1}, commanded=np.array((0.4, 0.1)))
    known = signals(heard)
    assert (known[position("knee")], known[commanded("knee")]) == (0.5, 0.4)
    assert known["tracking error knee [rad]"] == pytest.approx(0.1)
    heard.commanded = np.zeros(0)
    assert commanded("knee") not in signals(heard)


@pytest.fixture
def nodes() -> Iterator[tuple[Any, Any]]:
    with reserve("signals") as reservation:
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=reservation.domain, signal_handler_options=SignalHandlerOptions.NO)
        made = [rclpy.create_node(name, context=context, enable_rosout=False) for name in ("speaks", "hears")]
        yield made[0], made[1]
        for node in made:
            node.destroy_node()
        context.try_shutdown()


def test_how_long_a_message_was_on_its_way_is_a_signal(nodes: tuple[Any, Any]) -> None:
    speaks, hears = nodes
    publisher, intake = speaks.create_publisher(JointState, "joint_states", 1), Intake()
    listener, name = Listener(hears, intake), "joint_states on its way [ms]"
    assert name not in signals(intake.heard)
    began = time.monotonic()
    while name not in signals(intake.heard):
        assert time.monotonic() < began + QUIET
        publisher.publish(JointState(name=["knee"], position=[0.5]))
        listener.look(time.monotonic())
    assert intake.heard.joints == {"knee": 0.5}
    assert 0.0 < signals(intake.heard)[name] < 1e3 * (time.monotonic() - began)


def test_any_topic_is_listened_to(nodes: tuple[Any, Any]) -> None:
    speaks, hears = nodes
    publisher, topics = speaks.create_publisher(Imu, "/imu", 1), Topics(hears, "")
    deadline = time.monotonic() + QUIET
    while "/imu" not in topics.offered():
        assert time.monotonic() < deadline
        topics._looked = float("-inf")
    topics.listen("/nothing")
    assert not topics.values()
    topics.listen("/imu")
    message = Imu()
    message.linear_acceleration.z = 9.8
    while "/imu linear_acceleration.z" not in topics.values():
        assert time.monotonic() < deadline
        publisher.publish(message)
        time.sleep(0.02)
    assert topics.values()["/imu linear_acceleration.z"] == 9.8
