"""What is said on both sides is in the bag, as it was said."""

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from mcap.reader import make_reader
from rclpy.action import ActionServer
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from vigir_humanoid_control_msgs.action import ChangeControlMode

from harness.instance import RunningInstance
from harness.waiting import wait_until
from tests.integration.bag_recorder import recorder as kit
from tests.integration.bag_recorder.recorder import BEST_EFFORT, JOINTS, KEPT, MOTORS, SECOND, metadata, motor, recorder
from valor.common.messages import JointSetpoints
from valor.common.topics import JOINT_SETPOINTS, MOTOR


def test_both_sides_are_in_one_bag_with_their_times(instance: RunningInstance, ros: Node) -> None:
    latched = ros.create_publisher(String, "/robot_description", KEPT)
    latched.publish(String(data="<robot/>"))
    states = ros.create_publisher(JointState, "/joint_states", kit.RELIABLE)
    imu = ros.create_publisher(String, "/best_effort", BEST_EFFORT)
    hidden = ros.create_publisher(String, "/_hidden", KEPT)
    hidden.publish(String(data="between nodes"))
    action = ActionServer(ros, ChangeControlMode, "/change_control_mode", lambda goal: None)

    path = recorder(instance)
    node = instance.node()
    motors, setpoints = MOTOR.publisher(node), JOINT_SETPOINTS.publisher(node)
    names = [f"joint_{i}" for i in range(JOINTS)]
    extra = kit.connect(path, motors, motor(0))
    extra_setpoints = kit.connect(path, setpoints, JointSetpoints(0, names, *np.zeros((3, JOINTS))))
    for publisher in (latched, states, imu):
        wait_until(publisher.get_subscription_count, 20.0, f"the recorder subscribes to {publisher.topic_name}")

    began = time.time_ns()
    for number in range(1, 501):
        motors.publish(motor(number))
        setpoints.publish(JointSetpoints(number, names, *np.full((3, JOINTS), float(number))))
        states.publish(JointState(name=names, position=[float(number)] * JOINTS))
        if number <= 20:
            imu.publish(String(data=str(number)))
        time.sleep(0.001)  # a stream, not a burst
    ended = time.time_ns()
    wait_until(lambda: kit.has(path, "/joint_states", 500), 20.0, "the ROS messages are in the bag", 0.3)
    received = time.time_ns()
    wait_until(lambda: kit.has(path, kit.SETPOINTS, 500 + extra_setpoints), 20.0, "so are Bifrost's", 0.3)
    assert instance.stop("bag_recorder") == 0
    action.destroy()

    found: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([path.parent]) as reader:  # opens by metadata.yaml, decodes by the definitions in the bag alone
        for connection, timestamp, data in reader.messages():
            found.setdefault(connection.topic, []).append((timestamp, reader.deserialize(data, connection.msgtype)))
    expected = {
        MOTORS: 500 + extra, kit.SETPOINTS: 500 + extra_setpoints, "/joint_states": 500, "/robot_description": 1,
    }  # fmt: skip
    assert {topic: len(found[topic]) for topic in expected} == expected
    reported = [int(message.data) for _, message in found["/best_effort"]]
    assert reported == sorted(set(reported)) and 0 < len(reported) <= 20  # some may be lost
    assert not [topic for topic in found if "/_" in topic and "/_action/" not in topic], (
        "hidden topics are not recorded"
    )
    check_motors(found[MOTORS][extra:], began - SECOND // 100, ended + SECOND // 100)
    for number, (timestamp, message) in enumerate(found["/joint_states"], 1):
        assert message.position[0] == number
        assert began <= timestamp <= received
    assert found["/robot_description"][0][1].data == "<robot/>"
    check_container(path)
    check_counts(path, {MOTORS: 500 + extra, "/joint_states": 500})


def check_counts(path: Path, expected: dict[str, int]) -> None:
    """The bag states how many messages of each topic it has, and the clock."""
    (recorded,) = metadata(path, "topics")
    reported = {topic: json.loads(text) for topic, text in recorded.items()}
    for topic, count in expected.items():
        assert reported[topic] == {"received": count, "dropped": 0, "written": count}
    assert {topic: count for topic, count in kit.counts(path).items() if count} == {
        topic: each["written"] for topic, each in reported.items() if each["written"]
    }
    (clock,) = metadata(path, "clock")
    assert clock["steps"] == "0" and abs(int(clock["drift_ns"])) < SECOND


def check_motors(found: list[tuple[int, Any]], began: int, ended: int) -> None:
    """They are what was sent, in order, with times from one to the other [ns]."""
    first = found[0][1].bifrost_sequence
    for number, (timestamp, message) in enumerate(found, 1):
        sent = motor(number)
        assert message.sequence == number and message.bifrost_sequence == first + number - 1
        assert message.header.frame_id == "test"
        assert message.header.stamp.sec * SECOND + message.header.stamp.nanosec == timestamp
        assert began <= timestamp <= ended
        assert message.mode.tobytes() == sent.mode.tobytes()
        for name in ("position", "velocity", "effort", "stiffness", "damping"):
            assert getattr(message, name).tobytes() == getattr(sent, name).tobytes(), name


def check_container(path: Path) -> None:
    """What it reports of itself, as MCAP and as a bag."""
    with open(path, "rb") as file:
        bag = make_reader(file, validate_crcs=True)
        assert bag.get_header().profile == "ros2"
        (origin,) = metadata(path, "valor")
        assert origin["robot"] == "escher"
        assert abs(int(origin["wall_minus_monotonic_ns"]) - (time.time_ns() - time.monotonic_ns())) < SECOND
        for schema, channel, message in bag.iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            assert message.publish_time <= message.log_time
    with Reader(path) as reader:
        (description,) = [each for each in reader.connections if each.topic == "/robot_description"]
        assert description.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"


def test_ros_stays_on_the_loopback_interface_and_out_of_shared_memory(instance: RunningInstance, ros: Node) -> None:
    recorder(instance)
    process = psutil.Process(instance.process("bag_recorder").pid)
    addresses = {connection.laddr.ip for connection in process.net_connections("udp")}
    assert addresses == {"127.0.0.1", "239.255.0.1"}  # the latter: discovery's multicast group
    assert not [area.path for area in process.memory_maps() if "/dev/shm/fast" in area.path]


def test_a_publisher_that_offers_less_than_the_others_is_received_too(instance: RunningInstance, ros: Node) -> None:
    first = ros.create_publisher(String, "/chatter", kit.RELIABLE)
    path = recorder(instance)
    wait_until(first.get_subscription_count, 20.0, "the recorder subscribes")
    second = ros.create_publisher(String, "/chatter", BEST_EFFORT)
    wait_until(second.get_subscription_count, 20.0, "it subscribes anew, asking for less")
    wait_until(first.get_subscription_count, 20.0, "and still hears the first")

    def both() -> bool:  # what is best effort may be lost on its way
        first.publish(String(data="first"))
        second.publish(String(data="second"))
        said = (deserialize_message(each.data, String).data for each in kit.messages(path, "/chatter"))
        return {"first", "second"} == set(said)

    wait_until(both, 20.0, "both are in the bag", 0.3)
    assert instance.stop("bag_recorder") == 0
