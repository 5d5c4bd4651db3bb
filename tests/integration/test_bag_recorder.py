"""The recorder as a process: a real daemon, real publishers on both sides, and the bag read by others' tools."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import threading
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import rclpy
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Message
from rclpy.action import ActionServer
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from vigir_humanoid_control_msgs.action import ChangeControlMode

import bifrost
from harness.instance import RunningInstance
from harness.motion_states import motion_state
from harness.waiting import wait_until
from valor.bag_recorder.bag import Bag, RecordedTopic
from valor.bag_recorder.bifrost_tap import QUEUE, BifrostTap
from valor.bag_recorder.clock import WallClock
from valor.bag_recorder.definitions import definition
from valor.bag_recorder.last_seconds import AFTER_FALL
from valor.bags import recordings, rosbag2_metadata
from valor.bags.recovery import recover
from valor.common.bounds import Bounds
from valor.common.errors import ValorError
from valor.common.instance import Instance, Recording
from valor.common.messages import JointSetpoints, Motor, SnapRequest, Statistics
from valor.common.processes import EXIT_CONFIGURATION
from valor.common.topics import JOINT_SETPOINTS, MOTION_STATE, MOTOR, SNAP, STATISTICS
from valor.valorctl import bag_player, recording_list, recording_report
from valor.valorctl.ros_domain import DOMAINS

JOINTS = 38
OLD = "2026-01-02_10-00-00"
SECOND = 1_000_000_000
RELIABLE = QoSProfile(depth=1000)
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def ros(instance: RunningInstance, monkeypatch: pytest.MonkeyPatch) -> Iterator[Node]:
    """A ROS node in this process, in the instance's domain."""
    for name, value in instance.instance.environment().items():
        monkeypatch.setenv(name, value)
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node("test", context=context)
    yield node
    node.destroy_node()
    context.shutdown()


def motor(sequence: int) -> Motor:
    """A message that compresses badly, as real ones do."""
    values = np.random.default_rng(sequence).normal(size=(5, JOINTS))
    return Motor(7, sequence, 3, np.full(JOINTS, 2, np.uint8), *values, "stand", 1)


def bags(instance: RunningInstance) -> list[Path]:
    return sorted(instance.instance.bags.rglob("*.mcap"), key=lambda path: path.stat().st_ctime_ns)


def counts(path: Path) -> Counter[str]:
    """Messages by topic that the file holds by now, finished or not."""
    copy = path.with_suffix(".copy")
    shutil.copyfile(path, copy)
    recover(copy)
    counted: Counter[str] = Counter()
    with open(copy, "rb") as file:
        for _, channel, _ in make_reader(file).iter_messages():
            counted[channel.topic] += 1
    copy.unlink()
    return counted


def has(path: Path, topic: str, number: int) -> bool:
    return counts(path)[topic] >= number


def recorder(instance: RunningInstance) -> Path:
    """Start the recorder; returns its bag."""
    before = set(bags(instance))
    instance.start("bag_recorder")
    instance.wait_ready("bag_recorder")
    (path,) = set(bags(instance)) - before
    return path


def connect(path: Path, publisher: bifrost.Publisher[Any], message: bifrost.Message) -> int:
    """Publish until the recorder hears: what comes before is lost, and rightly so. Returns how many it heard."""
    topic = "/bifrost/" + publisher.topic
    sent = []

    def heard() -> bool:
        sent.append(publisher.publish(message))
        return len(sent) % 10 == 0 and has(path, topic, 1)

    wait_until(heard, 20.0, f"the recorder hears {publisher.topic}", 0.05)
    wait_until(lambda: newest(path, topic) == sent[-1], 20.0, "and all that was said so far", 0.2)
    return counts(path)[topic]


def messages(path: Path, topic: str) -> list[Message]:
    """Those of a topic that the file holds by now."""
    copy = path.with_suffix(".copy")
    shutil.copyfile(path, copy)
    recover(copy)
    with open(copy, "rb") as file:
        found = [message for _, _, message in make_reader(file).iter_messages(topics=[topic])]
    copy.unlink()
    return found


def newest(path: Path, topic: str) -> int:
    found = messages(path, topic)
    return found[-1].sequence if found else 0


class Stream(threading.Thread):
    """Publishes Motor at a steady rate until told to stop."""

    def __init__(self, publisher: bifrost.Publisher[Motor], rate: float) -> None:
        super().__init__(daemon=True)
        self._publisher, self._period = publisher, 1.0 / rate
        self.stopping = threading.Event()
        self.sent: list[int] = []  # sequences

    def run(self) -> None:
        sequence = 0
        while not self.stopping.wait(self._period):
            sequence = self._publisher.publish(motor(sequence))
            self.sent.append(sequence)

    def stop(self) -> None:
        self.stopping.set()
        self.join()


def test_both_sides_are_in_one_bag_with_their_times(instance: RunningInstance, ros: Node) -> None:
    latched = ros.create_publisher(String, "/robot_description", KEPT)
    latched.publish(String(data="<robot/>"))
    states = ros.create_publisher(JointState, "/joint_states", RELIABLE)
    imu = ros.create_publisher(String, "/best_effort", BEST_EFFORT)
    action = ActionServer(ros, ChangeControlMode, "/change_control_mode", lambda goal: None)

    path = recorder(instance)
    node = instance.node()
    motors, setpoints = MOTOR.publisher(node), JOINT_SETPOINTS.publisher(node)
    names = [f"joint_{i}" for i in range(JOINTS)]
    extra = connect(path, motors, motor(0))
    extra_setpoints = connect(path, setpoints, JointSetpoints(0, names, *np.zeros((3, JOINTS))))
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
    wait_until(lambda: has(path, "/joint_states", 500), 20.0, "the ROS messages are in the bag", 0.3)
    heard = time.time_ns()
    wait_until(
        lambda: has(path, "/bifrost/" + JOINT_SETPOINTS.name, 500 + extra_setpoints), 20.0, "so are Bifrost's", 0.3
    )
    assert instance.stop("bag_recorder") == 0
    action.destroy()

    found: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([path.parent]) as reader:  # opens by metadata.yaml, decodes by the definitions in the bag alone
        for connection, timestamp, data in reader.messages():
            found.setdefault(connection.topic, []).append((timestamp, reader.deserialize(data, connection.msgtype)))
    expected = {
        "/bifrost/" + MOTOR.name: 500 + extra,
        "/bifrost/" + JOINT_SETPOINTS.name: 500 + extra_setpoints,
        "/joint_states": 500,
        "/robot_description": 1,
    }
    assert {topic: len(found[topic]) for topic in expected} == expected
    told = [int(message.data) for _, message in found["/best_effort"]]
    assert told == sorted(set(told)) and 0 < len(told) <= 20  # some may be lost
    assert not [topic for topic in found if "/_" in topic], "hidden topics are not recorded"

    first = found["/bifrost/" + MOTOR.name][extra][1].bifrost_sequence
    for number, (timestamp, message) in enumerate(found["/bifrost/" + MOTOR.name][extra:], 1):
        sent = motor(number)
        assert message.sequence == number
        assert message.bifrost_sequence == first + number - 1
        assert message.header.frame_id == "test"
        assert message.header.stamp.sec * SECOND + message.header.stamp.nanosec == timestamp
        assert began - SECOND // 100 <= timestamp <= ended + SECOND // 100
        assert message.mode.tobytes() == sent.mode.tobytes()
        for name in ("position", "velocity", "effort", "stiffness", "damping"):
            assert getattr(message, name).tobytes() == getattr(sent, name).tobytes(), name
    for number, (timestamp, message) in enumerate(found["/joint_states"], 1):
        assert message.position[0] == number
        assert began <= timestamp <= heard
    assert found["/robot_description"][0][1].data == "<robot/>"

    with open(path, "rb") as file:
        bag = make_reader(file, validate_crcs=True)
        assert bag.get_header().profile == "ros2"
        (origin,) = [record.metadata for record in bag.iter_metadata() if record.name == "valor"]
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


def test_two_thousand_messages_a_second_are_all_kept(instance: RunningInstance) -> None:
    path = recorder(instance)
    node = instance.node()
    motors, setpoints = MOTOR.publisher(node), JOINT_SETPOINTS.publisher(node)
    names = [f"joint_{i}" for i in range(JOINTS)]
    message, setpoint = motor(1), JointSetpoints(1, names, *np.zeros((3, JOINTS)))
    extra, extra_setpoints = connect(path, motors, message), connect(path, setpoints, setpoint)
    number, due = 2000, time.monotonic()
    for _ in range(number):
        motors.publish(message)
        setpoints.publish(setpoint)
        due += 0.001
        time.sleep(max(0.0, due - time.monotonic()))
    wait_until(
        lambda: has(path, "/bifrost/" + JOINT_SETPOINTS.name, number + extra_setpoints), 20.0, "all are in the bag", 0.3
    )
    statistics = STATISTICS["bag_recorder"].subscriber(node)
    received = statistics.receive(timeout=10.0)
    assert received is not None and received.message.drops == 0
    assert instance.stop("bag_recorder") == 0
    assert counts(path)["/bifrost/" + MOTOR.name] == number + extra


def test_a_killed_recorder_leaves_a_bag_that_the_next_one_finishes(instance: RunningInstance) -> None:
    first = recorder(instance)
    node = instance.node()
    stream = Stream(MOTOR.publisher(node), 200.0)
    stream.start()
    wait_until(lambda: has(first, "/bifrost/" + MOTOR.name, 400), 30.0, "two seconds are in the bag", 0.3)
    said = stream.sent[-1]
    wait_until(lambda: newest(first, "/bifrost/" + MOTOR.name) >= said, 30.0, "so is all that was said by then", 0.3)
    instance.kill("bag_recorder")

    second = recorder(instance)
    assert second != first
    assert recover(first).finished, "finished by the one that came after"
    with open(first, "rb") as file:
        sequences = [m.sequence for _, c, m in make_reader(file).iter_messages() if c.topic.endswith("/motor")]
    assert sequences == list(range(sequences[0], sequences[-1] + 1))
    assert sequences[-1] >= said

    wait_until(lambda: has(second, "/bifrost/" + MOTOR.name, 100), 30.0, "the new bag goes on", 0.3)
    stream.stop()
    assert instance.stop("bag_recorder") == 0
    assert recover(second).finished
    (gap,) = metadata(second, "event")
    with open(first, "rb") as file, open(second, "rb") as after:
        last = max(message.log_time for _, _, message in make_reader(file).iter_messages())
        begun = min(message.log_time for _, _, message in make_reader(after).iter_messages())
    assert (gap["what"], int(gap["stamp_ns"])) == ("gap", last)
    assert float(gap["reason"].split()[-2]) == pytest.approx((begun - last) * 1e-9, abs=5.0)


def test_a_full_disk_costs_no_more_than_what_does_not_fit(instance: RunningInstance) -> None:
    """Full when the recorder starts, then with room, then full again, and with room again."""
    node = instance.node()
    statistics = STATISTICS["bag_recorder"].subscriber(node, queue=100)

    def heard(state: str) -> Statistics | None:
        said = [each.message for each in statistics.drain() if each.message.state == state]
        return said[-1] if said else None

    process = psutil.Process(instance.start("bag_recorder").pid)
    _, hard = process.rlimit(psutil.RLIMIT_FSIZE)
    process.rlimit(psutil.RLIMIT_FSIZE, (700, hard))  # less than a bag says of itself first
    told = wait_until(lambda: heard("degraded"), 40.0, "the recorder runs, and says that it does not record")
    assert "not recording: " in told.detail and "File too large" in told.detail
    assert process.is_running() and bags(instance) == []
    process.rlimit(psutil.RLIMIT_FSIZE, (resource.RLIM_INFINITY, hard))
    wait_until(lambda: heard("ready"), 30.0, "the recorder records")
    (path,) = bags(instance)
    stream = Stream(MOTOR.publisher(node), 200.0)
    stream.start()
    wait_until(lambda: has(path, "/bifrost/" + MOTOR.name, 100), 30.0, "the bag has begun", 0.3)

    process.rlimit(psutil.RLIMIT_FSIZE, (path.stat().st_size + (64 << 10), hard))
    told = wait_until(lambda: heard("degraded"), 20.0, "the recorder says that it does not record")
    assert "not recording: " in told.detail and path.name in told.detail and "File too large" in told.detail
    assert recover(path).finished
    kept = counts(path)["/bifrost/" + MOTOR.name]
    assert kept >= 100

    process.rlimit(psutil.RLIMIT_FSIZE, (resource.RLIM_INFINITY, hard))
    wait_until(lambda: heard("ready"), 30.0, "the recorder records again")
    stream.stop()
    assert instance.process("bag_recorder").poll() is None
    assert instance.log("bag_recorder").count("not recording") == 1
    assert instance.log("bag_recorder").count("stopped recording") == 1
    assert instance.stop("bag_recorder") == 0
    assert counts(path)["/bifrost/" + MOTOR.name] == kept
    assert len(bags(instance)) == 2


def test_a_publisher_that_offers_less_than_the_others_is_heard_too(instance: RunningInstance, ros: Node) -> None:
    first = ros.create_publisher(String, "/chatter", RELIABLE)
    path = recorder(instance)
    wait_until(first.get_subscription_count, 20.0, "the recorder subscribes")
    second = ros.create_publisher(String, "/chatter", BEST_EFFORT)
    wait_until(second.get_subscription_count, 20.0, "it subscribes anew, asking for less")
    wait_until(first.get_subscription_count, 20.0, "and still hears the first")

    def both() -> bool:  # what is best effort may be lost on its way
        first.publish(String(data="first"))
        second.publish(String(data="second"))
        said = (deserialize_message(each.data, String).data for each in messages(path, "/chatter"))
        return {"first", "second"} == set(said)

    wait_until(both, 20.0, "both are in the bag", 0.3)
    assert instance.stop("bag_recorder") == 0


def test_a_topic_keeps_every_nth_message_or_none(instance: RunningInstance, tmp_path: Path) -> None:
    third, none = replace(MOTOR, record_every=3), replace(JOINT_SETPOINTS, record_every=0)
    tap = BifrostTap(instance.node("recorder"), WallClock(), (third, none))
    bag = Bag(tmp_path / "a.mcap")
    node = instance.node()
    motors, setpoints = MOTOR.publisher(node), JOINT_SETPOINTS.publisher(node)

    def all_heard() -> bool:
        tap.drain(bag)
        motors.publish(motor(0))
        setpoints.publish(JointSetpoints(0, [], *np.zeros((3, 0))))
        return tap.counts["/bifrost/" + MOTOR.name][0] >= 30

    wait_until(all_heard, 20.0, "thirty messages")
    bag.close()
    with open(bag.path, "rb") as file:
        found = [(channel.topic, m.sequence) for _, channel, m in make_reader(file).iter_messages()]
    assert {topic for topic, _ in found} == {"/bifrost/" + MOTOR.name}
    sequences = [sequence for _, sequence in found]
    assert sequences == list(range(sequences[0], sequences[-1] + 1, 3))
    assert all(sequence % 3 == 0 for sequence in sequences) and len(sequences) >= 9
    assert {dropped for _, dropped in tap.counts.values()} == {0}


@pytest.mark.parametrize(
    ("bag", "told"),
    [
        ("/dev/null/a.mcap", "/dev/null"),
        ("/tmp/a.bag", "bag: /tmp/a.bag: expected a folder or a name that ends in .mcap"),
    ],
)
def test_a_bag_that_cannot_be_written_is_one_clear_line(instance: RunningInstance, bag: str, told: str) -> None:
    instance.configure(bag=Path(bag))
    process = instance.start("bag_recorder")
    assert process.wait(30) == EXIT_CONFIGURATION
    (line,) = instance.log("bag_recorder").splitlines()
    assert "ERROR bag_recorder" in line and told in line


def test_a_bag_that_exists_is_kept(instance: RunningInstance) -> None:
    wanted = instance.instance.bags / "run.mcap"
    wanted.write_bytes(b"precious")
    instance.configure(bag=wanted)
    path = recorder(instance)
    assert path.name == "run_1.mcap"
    assert instance.stop("bag_recorder") == 0
    assert wanted.read_bytes() == b"precious"
    assert recover(path).finished


def test_a_named_folder_is_one_bag_whatever_happens_to_its_recorder(instance: RunningInstance) -> None:
    folder = instance.instance.bags / "walk"
    instance.configure(bag=folder)
    first = recorder(instance)
    wait_until(lambda: has(first, "/bifrost/bag_recorder/statistics", 1), 20.0, "something is in the bag", 0.3)
    instance.kill("bag_recorder")
    second = recorder(instance)
    wait_until(lambda: has(second, "/bifrost/bag_recorder/statistics", 1), 20.0, "something is in the bag", 0.3)
    assert instance.stop("bag_recorder") == 0
    assert [first, second] == [folder / "walk.mcap", folder / "walk_1.mcap"]
    with AnyReader([folder]) as reader:
        counted = sum(recover(path).messages for path in (first, second))
        assert reader.message_count == counted
        assert len([1 for _ in reader.messages()]) == counted


def metadata(path: Path, name: str) -> list[dict[str, str]]:
    with open(path, "rb") as file:
        return [record.metadata for record in make_reader(file).iter_metadata() if record.name == name]


def test_what_became_of_each_topic_is_in_the_bag_and_in_the_log(instance: RunningInstance, ros: Node) -> None:
    chatter = ros.create_publisher(String, "/chatter", RELIABLE)
    path = recorder(instance)
    node = instance.node()
    motors = MOTOR.publisher(node)
    extra = connect(path, motors, motor(0))
    wait_until(chatter.get_subscription_count, 20.0, "the recorder subscribes")
    for number in range(100):
        motors.publish(motor(number))
        chatter.publish(String(data=str(number)))
    wait_until(lambda: has(path, "/chatter", 100), 20.0, "ROS is in the bag", 0.3)
    wait_until(lambda: has(path, "/bifrost/" + MOTOR.name, 100 + extra), 20.0, "so is Bifrost", 0.3)
    assert instance.stop("bag_recorder") == 0

    (found,) = metadata(path, "topics")
    told = {topic: json.loads(text) for topic, text in found.items()}
    assert told["/chatter"] == {"received": 100, "dropped": 0, "written": 100}
    assert told["/bifrost/" + MOTOR.name] == {"received": 100 + extra, "dropped": 0, "written": 100 + extra}
    assert {topic: count for topic, count in counts(path).items() if count} == {
        topic: each["written"] for topic, each in told.items() if each["written"]
    }
    (clock,) = metadata(path, "clock")
    assert clock["steps"] == "0" and abs(int(clock["drift_ns"])) < SECOND
    (line,) = [line for line in instance.log("bag_recorder").splitlines() if " /chatter " in line]
    assert line.split()[-3:] == ["100", "100", "0"]


def test_only_topics_that_are_asked_for_are_recorded(instance: RunningInstance, ros: Node) -> None:
    instance.configure(recording=Recording(only=("/bifrost/motion_manager/*", "/chatter"), without=("*_setpoints",)))
    wanted, other = (ros.create_publisher(String, name, KEPT) for name in ("/chatter", "/noise"))
    path = recorder(instance)
    node = instance.node()
    motors, setpoints = MOTOR.publisher(node), JOINT_SETPOINTS.publisher(node)
    connect(path, motors, motor(0))
    setpoints.publish(JointSetpoints(0, [], *np.zeros((3, 0))))
    other.publish(String(data="not this"))
    wanted.publish(String(data="this"))
    wait_until(lambda: has(path, "/chatter", 1), 20.0, "what is wanted is in the bag", 0.2)
    assert instance.stop("bag_recorder") == 0
    assert set(counts(path)) == {"/bifrost/" + MOTOR.name, "/chatter"}


def test_bags_split_by_size_hold_all_between_them_and_each_what_is_latched(
    instance: RunningInstance, ros: Node
) -> None:
    description = ros.create_publisher(String, "/robot_description", KEPT)
    description.publish(String(data="<robot/>"))
    instance.configure(recording=Recording(split_bytes=1 << 20))
    path = recorder(instance)
    wait_until(lambda: has(path, "/robot_description", 1), 20.0, "what is latched is in the first bag", 0.2)
    node = instance.node()
    stream = Stream(MOTOR.publisher(node), 800.0)
    stream.start()
    wait_until(lambda: len(bags(instance)) >= 3, 60.0, "two bags are full", 0.1)
    stream.stop()
    assert instance.stop("bag_recorder") == 0
    made = bags(instance)
    assert made[0] == path and all(recover(each).finished for each in made)
    sequences = []
    for each in made:
        assert counts(each)["/robot_description"] == 1
        with open(each, "rb") as file:
            sequences += [m.sequence for _, c, m in make_reader(file).iter_messages() if c.topic.endswith("/motor")]
    assert sequences == list(range(sequences[0], sequences[-1] + 1))
    assert sequences[-1] == stream.sent[-1]
    told = [json.loads(metadata(each, "topics")[0]["/bifrost/" + MOTOR.name]) for each in made]
    assert [each["received"] for each in told] == [each["written"] for each in told]
    with AnyReader(made) as reader:  # the row reads as one bag
        assert reader.message_count == sum(sum(counts(each).values()) for each in made)


def test_a_recorder_keeps_all_recordings_within_bounds_its_own_pieces_too(instance: RunningInstance) -> None:
    folder = instance.instance.bags
    kept, old = (a_recording(folder, name, size) for name, size in (("2026-01-01_10-00-00", 6 << 20), (OLD, 1 << 20)))
    recordings.keep(recordings.look(folder)[0], True)
    (folder / "walk").mkdir()
    foreign = folder / "walk" / "walk.mcap"
    shutil.copyfile(kept, foreign)
    bounds = Bounds(age=None, size=9 << 20, share=None)
    instance.configure(recording=Recording(bounds=bounds, only=("/bifrost/" + MOTOR.name,)))
    path = recorder(instance)
    node = instance.node()
    stream = Stream(MOTOR.publisher(node), 1000.0)
    stream.start()
    wait_until(lambda: not path.exists(), 60.0, "its own first piece has gone", 0.1)
    glance = recording_report.glance(instance.instance, bounds)
    assert glance.path is not None and glance.path.parent == path.parent and 0 < glance.size < glance.total
    assert recordings.holding(instance.instance.folder, time.time() - 0.01) is not None
    stream.stop()
    assert instance.stop("bag_recorder") == 0

    assert kept.exists() and foreign.exists() and not old.parent.exists()
    made = sorted(path.parent.glob("*.mcap"), key=lambda each: each.stat().st_mtime)
    assert made and sum(each.size for each in recordings.look(folder)) <= bounds.size + (2 << 20)
    sequences = []
    for each in made:
        with open(each, "rb") as file:
            sequences += [message.sequence for _, _, message in make_reader(file).iter_messages()]
    assert sequences == list(range(sequences[0], stream.sent[-1] + 1)), "all that was written since"
    with AnyReader([path.parent]) as reader:
        assert reader.message_count == len(sequences)
    assert instance.log("bag_recorder").count(": removed, ") == 1 + int(re.findall(r"_(\d+)$", made[0].stem)[0])


def a_recording(folder: Path, name: str, size: int) -> Path:
    """One of long ago."""
    path = folder / name / f"{name}.mcap"
    path.parent.mkdir()
    bag = Bag(path)
    chatter = RecordedTopic("/chatter", "std_msgs/msg/String", definition("std_msgs/msg/String"))
    bag.write(chatter, 0, 0, 0, np.random.default_rng(0).bytes(size))
    bag.close()
    os.utime(path, (recordings.begun(name),) * 2)
    return path


def test_what_was_lost_while_the_recorder_stood_is_counted(instance: RunningInstance) -> None:
    path = recorder(instance)
    publisher = MOTOR.publisher(instance.node())
    connect(path, publisher, motor(0))
    process = psutil.Process(instance.process("bag_recorder").pid)
    process.suspend()
    message = motor(1)
    for _ in range(4 * QUEUE):
        publisher.publish(message)
    process.resume()
    last = 0

    def heard() -> bool:
        nonlocal last
        last = publisher.publish(message)
        time.sleep(0.1)
        return newest(path, "/bifrost/" + MOTOR.name) > 4 * QUEUE

    wait_until(heard, 60.0, "the recorder goes on")
    wait_until(lambda: newest(path, "/bifrost/" + MOTOR.name) == last, 20.0, "to the last message", 0.3)
    assert instance.stop("bag_recorder") == 0
    with open(path, "rb") as file:
        topics = ["/bifrost/" + MOTOR.name]
        first = next(message.sequence for _, _, message in make_reader(file).iter_messages(topics=topics))
    told = json.loads(metadata(path, "topics")[0]["/bifrost/" + MOTOR.name])
    assert told["dropped"] > 0 and told["received"] == told["written"]
    assert told["received"] + told["dropped"] == last - first + 1


def test_the_last_seconds_are_saved_when_asked_and_on_a_fall(instance: RunningInstance, ros: Node) -> None:
    description = ros.create_publisher(String, "/robot_description", KEPT)
    description.publish(String(data="<robot/>"))
    instance.configure(recording=Recording(ring_seconds=2.0))
    instance.start("bag_recorder")
    instance.wait_ready("bag_recorder")
    assert bags(instance) == []
    wait_until(lambda: description.get_subscription_count() == 1, 20.0, "the recorder hears what is latched")
    node = instance.node()
    client = SNAP.client(node)
    stream = Stream(MOTOR.publisher(node), 100.0)
    stream.start()
    states = MOTION_STATE.publisher(node)
    wait_until(lambda: len(stream.sent) > 300, 30.0, "more than fits in two seconds")

    reply = client.call(SnapRequest(), timeout=20.0)
    assert reply.accepted, reply.reason
    saved = Path(reply.path)
    assert bags(instance) == [saved] and saved.stem.endswith("_snap") and recover(saved).finished
    found = counts(saved)
    assert found["/robot_description"] == 1 and sum(found.values()) == reply.messages
    assert 0 < found["/bifrost/" + MOTOR.name] < len(stream.sent) - 50
    assert newest(saved, "/bifrost/" + MOTOR.name) > 250

    def fallen() -> list[Path]:
        states.publish(motion_state(behavior="fall", contacts=np.zeros(2, np.uint8)))
        return [each for each in bags(instance) if "_fall" in each.stem]

    began = time.monotonic()
    (fall,) = wait_until(fallen, 30.0, "the fall is saved", 0.05)
    assert time.monotonic() - began >= AFTER_FALL
    wait_until(lambda: metadata_of_finished(fall), 20.0, "all of it", 0.1)
    assert counts(fall)["/bifrost/" + MOTION_STATE.name] > 1
    head = wait_until(lambda: rosbag2_metadata.head(fall.parent), 20.0, "rosbag2 knows")
    ((when, what),) = head.events.items()
    assert what.startswith("fall: ")
    fell = datetime.fromisoformat(when).timestamp()
    assert recordings.holding(instance.instance.folder, fell + 0.5) == fall  # two seconds are held, two follow a fall
    (row,) = (row for row in recording_list.rows(instance.instance) if row.name == fall.parent.name)
    assert (row.size, row.written, row.instance) == (fall.stat().st_size, False, "test")
    assert len(row.events) == 1 and row.events[0].endswith(what)
    for _ in range(20):
        fallen()
    assert len(bags(instance)) == 2, "a fall is saved once"
    stream.stop()
    assert instance.stop("bag_recorder") == 0
    assert len(bags(instance)) == 2


def metadata_of_finished(path: Path) -> bool:
    try:
        return bool(metadata(path, "topics"))
    except McapError:
        return False


def test_a_recorder_of_everything_has_nothing_to_snap(instance: RunningInstance) -> None:
    recorder(instance)
    client = SNAP.client(instance.node())
    reply = client.call(SnapRequest(), timeout=20.0)
    assert not reply.accepted and "everything is being recorded" in reply.reason


def test_a_bag_is_played_in_order_and_at_its_pace_but_not_into_a_running_system(
    instance: RunningInstance, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in instance.instance.environment().items():
        monkeypatch.setenv(name, value)
    bag = Bag(tmp_path / "played.mcap")
    kept = RecordedTopic("/kept", "std_msgs/msg/String", definition("std_msgs/msg/String"))
    chatter = RecordedTopic("/chatter", "std_msgs/msg/String", definition("std_msgs/msg/String"), "durability: 1", True)
    unknown = RecordedTopic("/wand", "magic_msgs/msg/Wand", "bool on\n")
    feedback_type = "vigir_humanoid_control_msgs/action/ChangeControlMode_Feedback"
    feedback = RecordedTopic("/arm/state", feedback_type, definition(feedback_type))
    bag.write(feedback, 0, 0, 0, serialize_message(ChangeControlMode.Feedback()))
    for number in (1, 0, 3, 2, 4):  # a recorder writes one topic after the other
        bag.write(chatter, number * SECOND // 5, 0, number, serialize_message(String(data=str(number))))
    bag.write(kept, 0, 0, 0, serialize_message(String(data="first")))
    bag.write(unknown, 1, 0, 0, b"\0\1\0\0\1")
    bag.close()
    domain = instance.settings.ros_domain_id
    quiet = {"rate": 1.0, "topics": (), "check": lambda: None, "tell": lambda passed, messages: None}
    with pytest.raises(ValorError, match=f"ROS domain {domain} is a running system's"):
        bag_player.play(bag.path, instance.instance, domain=domain, **quiet)

    heard: list[str] = []
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # found late, it still hears all
    nobodys = domain + len(DOMAINS)  # beyond those of instances, and of no other test
    context = Context()
    rclpy.init(context=context, domain_id=nobodys)
    listener = rclpy.create_node("listener", context=context)
    listener.create_subscription(String, "/chatter", lambda message: heard.append(message.data), latched)
    elsewhere = Instance("elsewhere", tmp_path)
    done = []
    player = threading.Thread(
        target=lambda: done.append(bag_player.play(bag.path, elsewhere, domain=nobodys, **quiet)), daemon=True
    )
    began = time.monotonic()
    player.start()
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(listener)

    def spun() -> bool:
        executor.spin_once(timeout_sec=0.05)
        return len(heard) == 5

    wait_until(spun, 30.0, "all five are heard", 0.0)
    player.join(20.0)
    assert done[0].messages == 7 and list(done[0].skipped) == ["/wand"]
    assert heard == ["0", "1", "2", "3", "4"]
    assert time.monotonic() - began > 0.8
    listener.destroy_node()
    context.shutdown()
