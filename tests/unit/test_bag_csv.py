"""CSV export of bags: of this product and of other recorders, truncated and damaged."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

import bifrost
from harness.examples import examples
from harness.places import ROBOTS
from tests.conftest import Valorctl
from valor.analysis.reading.csv_export import export
from valor.bag_recorder.bag import Bag, RecordedTopic
from valor.bag_recorder.bifrost_tap import TwinEncoder, twin_type
from valor.bags.stored import StoredBag
from valor.common.messages import Motor
from valor.robot.description import RobotDescription
from valor.ros.definitions import definition

ROBOT = RobotDescription.load(ROBOTS / "escher")
COUNT = 400  # messages a topic
STORE = get_typestore(Stores.ROS2_JAZZY)
Time, Header = STORE.types["builtin_interfaces/msg/Time"], STORE.types["std_msgs/msg/Header"]
JointState, String = STORE.types["sensor_msgs/msg/JointState"], STORE.types["std_msgs/msg/String"]
Image = STORE.types["sensor_msgs/msg/Image"]


def joint_state(number: int, names: list[str]) -> object:
    values = np.arange(len(names)) + number * 0.1
    return JointState(Header(Time(number, 7), "base"), names, values, -values, np.array([]))


def write(folder: Path, count: int, names: tuple[str, ...] = ("elbow", "knee")) -> Path:
    """A foreign bag; returns its one file."""
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        joints = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=STORE)
        words = writer.add_connection("/words", "std_msgs/msg/String", typestore=STORE)
        for i in range(count):
            data = STORE.serialize_cdr(joint_state(i, list(names)), "sensor_msgs/msg/JointState")
            writer.write(joints, 1000 + i, data)
            writer.write(
                words, 1000 + i, STORE.serialize_cdr(String(f'word "{i}",\n{"x" * 200}'), "std_msgs/msg/String")
            )
    (file,) = folder.glob("*.mcap")
    return file


def table(file: Path) -> list[dict[str, str]]:
    with open(file, newline="", encoding="utf-8") as opened:
        return list(csv.DictReader(opened))


@pytest.mark.parametrize("whole", [True, False], ids=["folder", "file"])
def test_the_csv_of_another_recorders_bag_has_its_values(tmp_path: Path, whole: bool) -> None:
    file = write(tmp_path / "bag", 20)
    made = export(file.parent if whole else file, tmp_path / "out")
    assert (made.notices, made.condition.damage, made.condition.messages) == ([], [], 40)
    assert {path.name: rows for path, rows in made.files.items()} == {"joint_states.csv": 20, "words.csv": 20}
    rows = table(tmp_path / "out" / "joint_states.csv")
    assert list(rows[0]) == [
        "log_time_ns", "header.stamp.sec", "header.stamp.nanosec", "header.frame_id", "position.elbow", "position.knee",
        "velocity.elbow", "velocity.knee",
    ]  # fmt: skip
    for i, row in enumerate(rows):
        assert (row["log_time_ns"], row["header.stamp.sec"], row["header.frame_id"]) == (str(1000 + i), str(i), "base")
        assert [float(row[f"position.{name}"]) for name in ("elbow", "knee")] == [0.0 + i * 0.1, 1.0 + i * 0.1]
    assert [row["data"] for row in table(tmp_path / "out" / "words.csv")] == [
        f'word "{i}",\n{"x" * 200}' for i in range(20)
    ]


def test_columns_of_our_arrays_have_the_joints_names(tmp_path: Path) -> None:
    name, encode = twin_type(Motor), TwinEncoder(Motor).encode
    topic = RecordedTopic("/bifrost/motion_manager/motor", name, definition(name))
    bag = Bag(tmp_path / "ours.mcap")
    bag.add_metadata("valor", {"joints": " ".join(ROBOT.joints)})  # as the recorder does
    n = len(ROBOT.joints)
    for i in range(5):
        motor = Motor(7, i, 3, np.full(n, 2, np.uint8), *np.full((5, n), float(i)), "stand", 1)  # type: ignore[call-arg]
        received = bifrost.Received(motor, stamp=i, sequence=i, origin="test")
        bag.write(topic, i, i, i, encode(received, i))
    bag.close()
    made = export(bag.path, tmp_path / "out", ["/bifrost/*/motor"])
    ((file, count),) = made.files.items()
    rows = table(file)
    assert len(rows) == count == 5
    assert [column for column in rows[0] if column.startswith("position.")] == [f"position.{j}" for j in ROBOT.joints]
    assert [float(row[f"effort.{ROBOT.joints[0]}"]) for row in rows] == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_later_columns_are_on_the_right_and_all_rows_have_equal_width(tmp_path: Path) -> None:
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        joints = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=STORE)
        for i, names in enumerate((["a", "b"], ["b", "a"], ["b", "c"], ["a", "b"], [])):
            data = STORE.serialize_cdr(joint_state(i, names), "sensor_msgs/msg/JointState")
            writer.write(joints, i, data)
    export(tmp_path / "bag", tmp_path / "out")
    with open(tmp_path / "out" / "joint_states.csv", newline="") as opened:
        lines = list(csv.reader(opened))
    assert {len(line) for line in lines} == {len(lines[0])}
    rows = table(tmp_path / "out" / "joint_states.csv")
    assert [[row["position.a"], row["position.b"], row["position.c"]] for row in rows] == [
        ["0.0", "1.0", ""], ["1.1", "0.1", ""], ["", "0.2", "1.2"], ["0.30000000000000004", "1.3", ""], ["", "", ""],
    ]  # fmt: skip


def test_unknown_types_and_long_arrays_are_reported_and_the_rest_is_written(tmp_path: Path) -> None:
    path = tmp_path / "mixed.mcap"
    with open(path, "wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros2", "somebody")
        unknown = writer.register_schema("magic_msgs/msg/Wand", "ros2msg", b"magic_msgs/Spell spell\n")
        wand = writer.register_channel("/wand", "cdr", unknown)
        text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        words = writer.register_channel("/words", "cdr", text)
        json = writer.register_channel("/json", "json", text)
        picture = writer.register_schema("sensor_msgs/msg/Image", "", b"")
        images = writer.register_channel("/image", "cdr", picture)
        for channel in (wand, json):
            writer.add_message(channel, 1, b"\\0\\1\\0\\0", 1)
        writer.add_message(words, 2, STORE.serialize_cdr(String("hello"), "std_msgs/msg/String"), 2)
        writer.add_message(words, 3, b"\0\1\0\0\xff\xff\xff", 3)
        image = Image(Header(Time(0, 0), ""), 40, 40, "rgb8", 0, 120, np.zeros(4800, np.uint8))
        writer.add_message(images, 4, STORE.serialize_cdr(image, "sensor_msgs/msg/Image"), 4)
        writer.finish()
    made = export(path, tmp_path / "out")
    assert made.condition.damage == []
    assert {file.name: rows for file, rows in made.files.items()} == {"words.csv": 1, "image.csv": 1}
    output = "\n".join(made.notices)
    expected = ("/wand: ", "magic_msgs/msg/Wand", "/json: messages are encoded in json", "/words: not std_msgs",
                "image.csv: data")  # fmt: skip
    assert all(each in output for each in expected), output
    assert table(tmp_path / "out" / "image.csv")[0]["data.length"] == "4800"


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("foreign") / "bag", COUNT)


@examples(10, HealthCheck.function_scoped_fixture)
@given(data=st.data())
def test_damage_never_raises(foreign: Path, tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(foreign.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(16, len(content) - 1))
        wrong = data.draw(st.binary(min_size=1, max_size=64))
        content[at : at + len(wrong)] = wrong
    file = tmp_path / f"damaged{foreign.suffix}"
    file.write_bytes(content)
    for _ in StoredBag(file).messages():
        pass


def test_the_verb_writes_what_is_readable_and_fails(tmp_path: Path, valorctl: Valorctl) -> None:
    file = write(tmp_path / "bag", COUNT)
    assert valorctl("bag", "csv", str(file), "--out", str(tmp_path / "whole"))[0] == 0
    file.write_bytes(file.read_bytes()[:-2000])
    status, _, err = valorctl("bag", "csv", str(file))
    assert status == 1 and "damaged;" in err and "bytes are whole" in err
    assert (file.parent / "bag_csv").is_dir()
    status, _, err = valorctl("bag", "csv", str(file))
    assert status == 1 and "expected an empty folder" in err
