"""Tried with what no one here wrote: a program with standard messages alone, and a bag read by ``rosbags``."""

from __future__ import annotations

import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from harness.instance import RunningInstance
from harness.system import RosClient
from tests.integration.vrc.documented_interfaces import rows
from tests.integration.vrc.vrc_system import PATIENCE, found_by, go

pytestmark = pytest.mark.timeout(580)
CLIENT = Path(__file__).with_name("foreign_client.py")
RARE = ("goal_status", "rejection", "controller_state")  # only on an occasion, or while listened to


@pytest.fixture(scope="module")
def said(system: RunningInstance) -> dict[str, Any]:
    """What the program found, recorded, the robot walking and manipulating; the mode is ours to choose."""
    system.start("bag_recorder", wait=True)
    client = RosClient(system.environment)
    try:
        go(client, "stand")
        go(client, "walk_manipulate")
    finally:
        client.close()
    return found_by(system, CLIENT)


def test_a_program_with_standard_messages_alone_reads_and_moves_the_robot(said: dict[str, Any]) -> None:
    assert said["imported"] == [], "it must not need the project"
    assert said["joints"] == 38
    assert said["mass"] == pytest.approx(75.9, abs=0.2)
    assert said["arm"]["error_code"] == 0, said["arm"]
    assert said["walked"] > 0.1


@pytest.fixture(scope="module")
def bag(system: RunningInstance, said: dict[str, Any]) -> Path:
    """The recording of all that, finished."""
    del said
    assert system.stop("bag_recorder", timeout=PATIENCE) == 0
    (path,) = system.instance.bags.rglob("*.mcap")
    return path


def test_a_recording_of_all_outputs_is_what_the_definitions_of_ros_2_say(bag: Path) -> None:
    """Types of the standard packages are decoded by rosbags' own definitions, which the bag's must equal."""
    standard = get_typestore(Stores.ROS2_JAZZY)
    outward = rows("Topics out")[0] + rows("Controller Bypass")[1]
    wanted = {row.name: row.type.replace("/", "/msg/") for row in outward if not row.name.endswith(RARE)}
    counts: dict[str, int] = defaultdict(int)
    stamps: dict[str, int] = {}
    checked = set()
    with AnyReader([bag]) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        assert wanted.items() <= kinds.items(), wanted.items() - kinds.items()
        for connection in reader.connections:
            if connection.msgtype in standard.fielddefs and not connection.topic.startswith("/bifrost"):
                ours = get_types_from_msg(connection.msgdef.data, connection.msgtype)
                for name, fields in ours.items():
                    assert fields == standard.fielddefs[name], f"{name} is not ROS 2's"
                checked.add(connection.msgtype)
        for connection, _, data in reader.messages():
            if connection.topic.startswith("/bifrost"):
                continue
            store = standard if connection.msgtype in checked else reader.typestore
            message = store.deserialize_cdr(data, connection.msgtype)
            counts[connection.topic] += 1
            if connection.topic in wanted:
                check(connection.topic, message, stamps)
    assert {"sensor_msgs/msg/JointState", "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"} <= checked
    assert not [name for name in wanted if not counts[name]], "recorded, and nothing in it"
    assert counts["/joint_states"] > 500


def check(topic: str, message: Any, stamps: dict[str, int]) -> None:
    """What holds for every message of a topic."""
    if header := getattr(message, "header", None):
        stamp = header.stamp.sec * 10**9 + header.stamp.nanosec
        assert stamp >= stamps.get(topic, 0), f"{topic}: stamps go back"
        stamps[topic] = stamp
    if topic in ("/imu/data", "/odom", "/flor/state/pelvis_pose_world") or "force_torque" in topic:
        assert header is not None and header.frame_id, topic
    if topic == "/joint_states":
        assert len(message.name) == len(message.position) == len(message.velocity) == len(message.effort) == 38
        assert all(map(math.isfinite, (*message.position, *message.velocity, *message.effort)))
    elif topic == "/imu/data":
        assert norm(message.orientation) == pytest.approx(1.0, abs=1e-6)
    elif topic == "/odom":
        assert header is not None
        assert (header.frame_id, message.child_frame_id) == ("odom", "base_link")
        assert norm(message.pose.pose.orientation) == pytest.approx(1.0, abs=1e-6)
        assert all(message.pose.covariance.reshape(6, 6).diagonal() >= 0.0)
    elif topic in ("/tf", "/tf_static"):
        for transform in message.transforms:
            assert transform.header.frame_id and transform.child_frame_id
            assert norm(transform.transform.rotation) == pytest.approx(1.0, abs=1e-6)


def norm(q: Any) -> float:
    return math.hypot(q.x, q.y, q.z, q.w)
