"""First bytes of a bag: as the MCAP library writes them, complete and truncated."""

import json
from datetime import datetime
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader

from harness.examples import examples
from valor.bag_recorder.bag import Bag, RecordedTopic
from valor.bag_recorder.bag_store import topic_counts
from valor.bags import rosbag2_metadata
from valor.bags.errors import BagError
from valor.bags.files import BEGINNING, LIBRARY, PROFILE, origin
from valor.bags.index import read_index
from valor.bags.rosbag2_metadata import EVENT
from valor.bags.selection import EVERYTHING, Selection
from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Bounds, Recording
from valor.valorctl.recordings.bag_summary import summarize
from valor.valorctl.recordings.recording_options import bounds, recording

TEXTS = st.dictionaries(st.text(max_size=20), st.text(max_size=20), max_size=5)


def written(file: Path, values: dict[str, str]) -> bytes:
    with open(file, "wb") as out:
        writer = Writer(out)
        writer.start(PROFILE, LIBRARY)
        writer.add_metadata("origin", values)
        writer.finish()
    return file.read_bytes()


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("bags") / "walk.mcap"


@examples(50)
@given(values=TEXTS.filter(bool), data=st.data())
def test_a_truncated_or_damaged_origin_is_empty(file: Path, values: dict[str, str], data: st.DataObject) -> None:
    whole = written(file, values)
    assert whole.startswith(BEGINNING) and origin(file) == values
    end = len(BEGINNING) + 9 + int.from_bytes(whole[len(BEGINNING) + 1 :][:8], "little")  # of the record
    cut = data.draw(st.integers(len(BEGINNING), end - 1), "cut")
    file.write_bytes(whole[:cut])
    assert origin(file) == {}
    garbage = data.draw(st.binary(max_size=80), "garbage")
    file.write_bytes(BEGINNING + garbage)
    origin(file)


# The recorder's options: topics, pieces, bounds; counts of messages.
def test_patterns_choose_topics() -> None:
    assert "/anything" in EVERYTHING
    some = Selection(only=("/bifrost/*", "/joint_states"), without=("*/statistics",))
    chosen = ["/bifrost/motion_manager/motor", "/joint_states"]
    assert all(topic in some for topic in chosen)
    assert not any(topic in some for topic in ("/odom", "/joint_states/more", "/bifrost/comms_manager/statistics"))


def test_options_become_settings_and_words_bounds() -> None:
    assert recording((), (), (), None) == Recording()
    made = recording(("/a*",), ("/ab",), ("500MB", "10min"), None)
    assert made == Recording(only=("/a*",), without=("/ab",), split_bytes=500_000_000, split_seconds=600.0)
    assert recording((), (), (), 30.0).ring_seconds == 30.0
    assert bounds([], Bounds()) == Bounds()
    assert bounds(["5GB", "12h", "25%"], Bounds()) == Bounds(age=43200.0, size=5 * 10**9, share=0.25)
    assert bounds(["500 MB"], Bounds()) == Bounds(size=500_000_000)
    assert bounds(["none"], Bounds()) == Bounds(age=None, size=None, share=None)


@pytest.mark.parametrize(
    ("words", "ring", "reported"),
    [
        (["10"], None, "--bag-split 10: expected a size or a time"),
        (["1MB", "2MB"], None, "--bag-split 2MB: expected one of each kind at most"),
        (["1kB"], None, "--bag-split: .*1048576.*, got 1000"),
        ([], float("nan"), "--bag-ring: expected a finite number, got nan$"),
        (["10s"], 5.0, "--bag-ring and --bag-split: expected one of them"),
        (["5"], None, "--bag-bound 5: expected a size, an age or a part of the disk"),
        (["120%"], None, "--bag-bound 120%: .* <= 1.*, got 1.2"),
        (["1MB"], None, "--bag-bound 1MB: expected int >= 8388608 B, got 1000000"),
        (["0d"], None, "--bag-bound 0d: .*, got 0"),
        (["none", "6GB"], None, "--bag-bound none 6GB: expected none by itself"),
    ],
)
def test_invalid_options_are_rejected(words: list[str], ring: float | None, reported: str) -> None:
    with pytest.raises(ConfigurationError, match=reported) as caught:
        bounds(words, Bounds()) if reported.startswith("--bag-bound") else recording((), (), words, ring)
    assert "\n" not in str(caught.value)


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 5), st.integers(0, 50)), min_size=1, max_size=6))
def test_each_bag_counts_the_messages_since_the_previous_one(bags: list[tuple[int, int, int]]) -> None:
    received, dropped, found = 0, 0, []
    before: dict[str, tuple[int, int]] = {}
    for arrived, lost, written in bags:
        received, dropped = received + arrived, dropped + lost
        now = {"/a": (received, dropped)}
        found.append(json.loads(topic_counts(now, before, {"/a": written})["/a"]))
        before = now
    assert [(each["received"], each["dropped"], each["written"]) for each in found] == bags


# metadata.yaml: a folder of bags for rosbag2.
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
        assert reader.message_count == 5 + 2 * 4 + 3 and (reader.start_time, reader.end_time) == (1000, 3003)
        assert {each.topic: each.msgcount for each in reader.connections} == {"/numbers": 7, "/words": 9}
        (words,) = (each for each in reader.connections if each.topic == "/words")
        assert words.ext.offered_qos_profiles[0].durability == QosDurability.TRANSIENT_LOCAL
        assert [stamp for connection, stamp, _ in reader.messages() if connection.topic == "/words"] == [
            *range(1000, 1005), *range(2000, 2004)
        ]  # fmt: skip
    assert [path.name for path in folder.iterdir() if path.suffix == ".new"] == []


@pytest.mark.parametrize("content", [b"", b"hello", b"something longer than the magic bytes of a bag"])
def test_a_file_that_is_not_a_bag_is_reported_in_one_line(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "walk" / "walk.mcap"
    file.parent.mkdir()
    file.write_bytes(content)
    with pytest.raises(ValorError, match=r"walk\.mcap: not a whole MCAP file"):
        summarize(file)
    assert rosbag2_metadata.write(file.parent) is None
    bag(tmp_path / "a" / "a.mcap", 1, 1, (WORDS,), close=False)
    assert rosbag2_metadata.write(tmp_path / "a") is None and not (tmp_path / "a" / "metadata.yaml").exists()


def test_the_metadata_lists_events(tmp_path: Path) -> None:
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


def test_the_index_equals_the_librarys_wherever_a_file_ends(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    bag(path, 1, 50, (WORDS, NUMBERS))
    found = read_index(path)
    with open(path, "rb") as file:
        expected = make_reader(file).get_summary()
    assert found is not None and expected is not None
    assert (found.statistics, found.channels) == (expected.statistics, expected.channels)
    assert found.schemas == expected.schemas
    content = path.read_bytes()
    for length in range(0, len(content), 7):
        path.write_bytes(content[:length])
        with pytest.raises(BagError):
            read_index(path)
