"""A bag of the robot of this folder, read by programs that nobody here wrote: mcap, rosbags, rerun.

What they decode by the definitions in the bag alone is held against rclpy's classes, and types' hashes against those
that rosbags reckons out of the definitions. Nothing in `foxglove-sdk` reads a file without Foxglove's account.
"""

import math
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from action_msgs.msg import GoalStatus
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from harness.system import System
from tests.integration.vrc.documented_interfaces import rows
from valor.bags.rosbag2_metadata import FILE
from valor.ros.definitions import message_type, type_hash

ARM = "/trajectory_controllers/right_arm_traj_controller/follow_joint_trajectory/_action"
WALK = "/robot_controllers/footstep_controller/execute_step_plan/_action"
READ = ("/joint_states", "/tf", "/tf_static", "/robot_description", "/odom", f"{ARM}/status", f"{ARM}/feedback")
SHARED = ("/rosout", "/tf_static")  # topics of several publishers
RARE = ("goal_status", "rejection", "controller_state")  # published only on an event, or to a subscriber
STRETCH = 30_000_000_000  # of a bag that is read completely [ns]
MOST = 500  # messages of a topic that are compared


@pytest.fixture(scope="module")
def bag(system: System) -> Path:
    """The folder of what was recorded while this folder's other tests ran."""
    system.valorctl("down")
    (folder,) = (Path(system.environment["VALOR_HOME"]) / system.name / "bags").glob("*/")
    return folder


@pytest.fixture(scope="module")
def file(bag: Path) -> Path:
    (found,) = bag.glob("*.mcap")
    return found


@pytest.fixture(scope="module")
def ours(file: Path) -> dict[str, list[tuple[int, Any]]]:
    """Log times [ns] and messages as rclpy's own classes have them, the first of each topic."""
    found: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    with open(file, "rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages(topics=READ):
            assert schema is not None
            if len(found[channel.topic]) < MOST:
                decoded = deserialize_message(message.data, message_type(schema.name))
                found[channel.topic].append((message.log_time, decoded))
    assert set(found) == set(READ)
    return found


def test_mcap_counts_types_hashes_and_stamps(bag: Path, file: Path) -> None:
    counts: Counter[str] = Counter()
    last: dict[str, int] = {}
    with open(file, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        for _, channel, message in reader.iter_messages(log_time_order=False):
            counts[channel.topic] += 1
            assert message.publish_time <= message.log_time
            if channel.topic not in SHARED:  # DDS orders the messages of one publisher only
                assert last.get(channel.topic, 0) <= message.log_time, f"{channel.topic} in the order of its log times"
            last[channel.topic] = message.log_time
    declared = {
        summary.channels[key].topic: number for key, number in summary.statistics.channel_message_counts.items()
    }
    assert counts == declared
    reported = yaml.safe_load((bag / FILE).read_text())["rosbag2_bagfile_information"]
    by_topic = {each["topic_metadata"]["name"]: each for each in reported["topics_with_message_count"]}
    assert {name: each["message_count"] for name, each in by_topic.items()} == declared
    for channel in summary.channels.values():
        name = summary.schemas[channel.schema_id].name
        digest = by_topic[channel.topic]["topic_metadata"]["type_description_hash"]
        assert channel.metadata["topic_type_hash"] == digest == type_hash(name) != "", channel.topic


def test_rosbags_reckons_the_same_hashes_and_decodes_the_same_values(
    bag: Path, ours: dict[str, list[tuple[int, Any]]]
) -> None:
    with Reader(bag) as reader:
        store = get_typestore(Stores.EMPTY)
        for connection in reader.connections:
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        for connection in reader.connections:
            assert connection.digest == store.hash_rihs01(connection.msgtype), connection.topic
        standard = get_typestore(Stores.ROS2_JAZZY).fielddefs
        equal = {name for name in standard if name in store.fielddefs and store.fielddefs[name] == standard[name]}
        assert not {name for name in store.fielddefs if name in standard} - equal, "types differ from those of ROS 2"
        assert {"sensor_msgs/msg/JointState", "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"} <= equal
        wanted = [each for each in reader.connections if each.topic in READ]
        seen: Counter[str] = Counter()
        for connection, stamp, data in reader.messages(wanted):
            place = seen[connection.topic]
            seen[connection.topic] += 1
            if place < MOST:
                own_stamp, own = ours[connection.topic][place]
                assert stamp == own_stamp
                assert plain(store.deserialize_cdr(data, connection.msgtype)) == plain(own), connection.topic
        assert seen == {each.topic: each.msgcount for each in wanted}


def test_what_became_of_goals_is_in_the_bag(bag: Path, ours: dict[str, list[tuple[int, Any]]]) -> None:
    ended = {goal.status for _, message in ours[f"{ARM}/status"] for goal in message.status_list}
    assert GoalStatus.STATUS_SUCCEEDED in ended
    feedback = [message.feedback for _, message in ours[f"{ARM}/feedback"]]
    assert len(feedback) >= 10 and all(each.joint_names == feedback[0].joint_names for each in feedback)
    goals = {bytes(goal.goal_info.goal_id.uuid) for _, each in ours[f"{ARM}/status"] for goal in each.status_list}
    assert {bytes(each.goal_id.uuid) for _, each in ours[f"{ARM}/feedback"]} <= goals
    with Reader(bag) as reader:
        assert {f"{WALK}/status", f"{WALK}/feedback"} <= {each.topic for each in reader.connections if each.msgcount}


def test_every_documented_topic_is_in_the_bag_and_its_stamps_never_go_back(bag: Path) -> None:
    documented = [row for row in rows("Topics out")[0] + rows("Controller Bypass")[1] if not row.name.endswith(RARE)]
    wanted = {row.name: row.type.replace("/", "/msg/") for row in documented}
    stamps: dict[str, int] = {}
    seen = set()
    with AnyReader([bag]) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        assert wanted.items() <= kinds.items(), wanted.items() - kinds.items()
        connections = [each for each in reader.connections if each.topic in wanted]
        for connection, _, data in reader.messages(connections, stop=reader.start_time + STRETCH):
            message: Any = reader.deserialize(data, connection.msgtype)
            seen.add(connection.topic)
            if header := getattr(message, "header", None):
                stamp = header.stamp.sec * 10**9 + header.stamp.nanosec
                assert stamp >= stamps.get(connection.topic, 0), f"{connection.topic}: stamps go back"
                stamps[connection.topic] = stamp
            for transform in getattr(message, "transforms", ()):
                q = transform.transform.rotation
                assert math.hypot(q.x, q.y, q.z, q.w) == pytest.approx(1.0, abs=1e-6)
    assert seen == set(wanted)


def test_tf_and_the_description_are_one_robot(ours: dict[str, list[tuple[int, Any]]]) -> None:
    urdf = ElementTree.fromstring(ours["/robot_description"][0][1].data)
    links = {name for name in (link.attrib["name"] for link in urdf.iter("link")) if not name.endswith("_hinge")}
    moving = {joint.attrib["name"] for joint in urdf.iter("joint") if joint.attrib["type"] != "fixed"}
    assert set(ours["/joint_states"][0][1].name) == moving
    frames = {
        each.child_frame_id
        for topic in ("/tf", "/tf_static")
        for _, reported in ours[topic]
        for each in reported.transforms
    }
    assert links <= frames | {"pelvis"}, "every link has a place"


def test_rerun_finds_the_same(file: Path, ours: dict[str, list[tuple[int, Any]]]) -> None:
    chunks = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed: make .venv/stock.stamp")
    reader = chunks.McapReader(file, include_topic_regex=[f"^{topic}$" for topic in ("/odom", "/tf", READ[3], READ[6])])
    reported = reader.info()
    with open(file, "rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None and summary.statistics is not None
    assert (reported.message_count, reported.channel_count) == (summary.statistics.message_count, len(summary.channels))
    rows: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    parts = {"/odom": "nav_msgs.msg.Odometry:message", "/tf": "Transform3D:translation", READ[3]: "TextDocument:text"}
    parts[READ[6]] = "control_msgs.action.FollowJointTrajectory_FeedbackMessage:message"
    for chunk in reader.stream():
        part = parts.get(chunk.entity_path)
        batch = chunk.to_record_batch()
        if part in batch.schema.names:
            stamps = batch.column("message_log_time").cast("int64").to_pylist()
            rows[chunk.entity_path] += zip(stamps, batch.column(part).to_pylist(), strict=True)
    assert rows[READ[3]][0][1][0] == ours[READ[3]][0][1].data
    for (stamp, (seen,)), (own_stamp, own) in zip(sorted(rows["/odom"], key=first), ours["/odom"], strict=False):
        assert stamp == own_stamp
        assert seen["pose"]["pose"]["position"] == plain(own.pose.pose.position)
    transforms = [
        (stamp, each.transform.translation) for stamp, reported in ours["/tf"] for each in reported.transforms
    ]
    for (stamp, (seen,)), (own_stamp, own) in zip(sorted(rows["/tf"], key=first), transforms, strict=False):
        assert stamp == own_stamp and seen == pytest.approx([own.x, own.y, own.z], abs=1e-5)  # 32 bits
    for (_, (seen,)), (_, own) in zip(sorted(rows[READ[6]], key=first), ours[READ[6]], strict=False):
        assert seen["feedback"]["actual"]["positions"] == list(own.feedback.actual.positions)
    assert all(rows[topic] for topic in parts)


def first(row: tuple[int, Any]) -> int:
    """Its time; the order of rows of one time stays."""
    return row[0]


def plain(message: Any) -> Any:
    """Fields by name, arrays as lists, of either's classes."""
    if hasattr(message, "get_fields_and_field_types"):
        return {name: plain(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if hasattr(message, "__msgtype__"):
        names = [name for name in message.__dataclass_fields__ if not name.isupper()]  # without constants
        return {name: plain(getattr(message, name)) for name in names if name != "__msgtype__"}
    if hasattr(message, "tolist"):
        return message.tolist()
    if isinstance(message, (list, tuple)) or type(message).__name__ == "array":
        return [plain(each) for each in message]
    return message
