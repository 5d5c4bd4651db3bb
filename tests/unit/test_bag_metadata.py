"""metadata.yaml: a folder of bags as rosbag2 reads it."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader

from valor.bag_recorder.bag import Bag, RecordedTopic
from valor.bags import rosbag2_metadata
from valor.bags.errors import BagError
from valor.bags.event import EVENT
from valor.bags.files import is_own_folder, origin
from valor.bags.index import read_index
from valor.common.errors import ValorError
from valor.valorctl.bag_summary import summarize

QOS = yaml.safe_dump([
    {"history": "keep_last", "depth": 10, "reliability": "reliable", "durability": "transient_local",
     "deadline": {"sec": 1, "nsec": 2}, "lifespan": {"sec": 1, "nsec": 2}, "liveliness": "automatic",
     "liveliness_lease_duration": {"sec": 1, "nsec": 2}, "avoid_ros_namespace_conventions": False}
])  # fmt: skip
WORDS = RecordedTopic("/words", "std_msgs/msg/String", "string data", QOS, latched=True)
NUMBERS = RecordedTopic("/numbers", "std_msgs/msg/Int64", "int64 data")


def bag(path: Path, first: int, count: int, topics: tuple[RecordedTopic, ...], close: bool = True) -> None:
    path.parent.mkdir(exist_ok=True)
    made = Bag(path)
    for i in range(count):
        for topic in topics:
            made.write(topic, first + i, first + i, i, b"\0\1\0\0\0\0\0\0")
    made.close() if close else made.abandon()


def test_the_splits_of_a_recording_are_one_bag_in_their_order(tmp_path: Path) -> None:
    folder = tmp_path / "walk"
    bag(folder / "walk.mcap", 1000, 5, (WORDS,))
    bag(folder / "walk_10.mcap", 3000, 3, (NUMBERS,))
    bag(folder / "walk_2.mcap", 2000, 4, (WORDS, NUMBERS))
    bag(folder / "walk_11.mcap", 4000, 4, (WORDS,), close=False)
    bag(folder / "another.mcap", 500, 9, (WORDS,))
    assert rosbag2_metadata.write(folder) == folder / "metadata.yaml"
    assert "&" not in (folder / "metadata.yaml").read_text()
    with Reader(folder) as reader:
        assert reader.message_count == 5 + 2 * 4 + 3
        assert (reader.start_time, reader.end_time) == (1000, 3003)
        assert {each.topic: each.msgcount for each in reader.connections} == {"/numbers": 7, "/words": 9}
        (words,) = (each for each in reader.connections if each.topic == "/words")
        assert words.ext.offered_qos_profiles[0].durability == QosDurability.TRANSIENT_LOCAL
        assert [stamp for connection, stamp, _ in reader.messages() if connection.topic == "/words"] == [
            *range(1000, 1005), *range(2000, 2004)
        ]  # fmt: skip
    assert [path.name for path in folder.iterdir() if path.suffix == ".new"] == []


def test_a_folder_is_summed_up(tmp_path: Path) -> None:
    bag(tmp_path / "walk" / "walk.mcap", 10**9, 5, (WORDS,))
    bag(tmp_path / "walk" / "walk_1.mcap", 2 * 10**9, 1, (WORDS, NUMBERS))
    found = summarize(tmp_path / "walk")
    assert (found.start, found.duration, found.messages) == (1.0, 1.0, 7)
    assert [(topic.name, topic.messages) for topic in found.topics] == [("/numbers", 1), ("/words", 6)]
    with pytest.raises(ValorError, match="expected files"):
        summarize(tmp_path)


@pytest.mark.parametrize("content", [b"", b"hello", b"something longer than the magic bytes of a bag"])
def test_what_is_no_bag_is_said_in_a_line(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "walk" / "walk.mcap"
    file.parent.mkdir()
    file.write_bytes(content)
    with pytest.raises(ValorError, match=r"walk\.mcap: not a whole MCAP file"):
        summarize(file)
    assert rosbag2_metadata.write(file.parent) is None


def test_what_happened_is_told_with_the_recording_as_a_whole(tmp_path: Path) -> None:
    path = tmp_path / "walk" / "walk.mcap"
    path.parent.mkdir()
    made = Bag(path)
    made.add_metadata("valor", {"instance": "lab", "started": "2026-05-01T10:00:00+00:00"})
    assert origin(path)["instance"] == "lab", "before it is finished"
    made.write(WORDS, 10**9, 10**9, 1, b"\0\1\0\0\0\0\0\0")
    made.add_metadata(EVENT, {"what": "fall", "stamp_ns": "1500000000", "reason": "pushed: hard"})
    made.write(WORDS, 3 * 10**9, 3 * 10**9, 2, b"\0\1\0\0\0\0\0\0")
    made.close()
    rosbag2_metadata.write(path.parent)
    head = rosbag2_metadata.head(path.parent)
    assert head is not None and (head.start, head.duration, head.messages) == (1.0, 2.0, 2)
    ((when, what),) = head.events.items()
    assert datetime.fromisoformat(when).timestamp() == 1.5 and what == "fall: pushed: hard"
    with Reader(path.parent) as reader:
        assert reader.message_count == 2
    assert rosbag2_metadata.head(tmp_path) is None


def test_an_index_is_that_of_the_library_wherever_a_file_ends(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    bag(path, 1, 50, (WORDS, NUMBERS))
    found = read_index(path)
    with open(path, "rb") as file:
        expected = make_reader(file).get_summary()
    assert found is not None and expected is not None
    assert (found.statistics, found.summary.channels) == (expected.statistics, expected.channels)
    assert found.summary.schemas == expected.schemas and found.summary.chunk_indexes == []
    content = path.read_bytes()
    for length in range(0, len(content), 7):
        path.write_bytes(content[:length])
        with pytest.raises(BagError):
            read_index(path)


def test_a_folder_without_a_finished_bag_gets_none(tmp_path: Path) -> None:
    bag(tmp_path / "a" / "a.mcap", 1, 1, (WORDS,), close=False)
    assert rosbag2_metadata.write(tmp_path / "a") is None
    assert not (tmp_path / "a" / "metadata.yaml").exists()


@pytest.mark.parametrize(
    ("file", "own"), [("walk/walk.mcap", True), ("walk/walk_1.mcap", True), ("bags/walk.mcap", False)]
)
def test_a_bag_stands_in_a_folder_of_its_own_name_or_not(file: str, own: bool) -> None:
    assert is_own_folder(Path(file)) == own
