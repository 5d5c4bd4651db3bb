"""Recovery of a bag that is cut anywhere keeps every message of every complete chunk."""

from contextlib import suppress
from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import Reader

from harness.examples import examples
from valor.bag_recorder.bag import Bag, RecordedTopic
from valor.bags.errors import BagError
from valor.bags.recovery import recover
from valor.ros.definitions import definition

TOPICS = [
    RecordedTopic(f"/{name}", f"std_msgs/msg/{name}", definition(f"std_msgs/msg/{name}"))
    for name in ("Bool", "Int64", "Float64")
]
Messages = list[tuple[str, int, int, bytes]]


def write(path: Path, chunks: list[list[int]], *, close: bool = True) -> tuple[Messages, list[tuple[int, int]]]:
    """A bag of chunks of messages on the topics given by index.

    Returns:
        The messages, and after every flush the file's size and how many messages it holds.
    """
    bag = Bag(path)
    bag.add_metadata("valor", {"seed": "0"})
    messages: Messages = []
    flushed = [(path.stat().st_size, 0)]
    for chunk in chunks:
        for index in chunk:
            number = len(messages) + 1
            data = b"\0\1\0\0" + number.to_bytes(8, "little")
            bag.write(TOPICS[index], 1000 + number, 500 + number, number, data)
            messages.append((TOPICS[index].name, 1000 + number, 500 + number, data))
        bag.flush()
        flushed.append((path.stat().st_size, len(messages)))
    if close:
        bag.close()
    else:
        bag.abandon()
    return messages, flushed


def read(path: Path) -> Messages:
    """By way of the index, which must agree with the records themselves and with what rosbags reads."""
    content = path.read_bytes()
    list(StreamReader(BytesIO(content), validate_crcs=True).records)
    found = [
        (channel.topic, message.log_time, message.publish_time, message.data)
        for _, channel, message in make_reader(BytesIO(content), validate_crcs=True).iter_messages()
    ]
    summary = make_reader(BytesIO(content)).get_summary()
    assert summary is not None and summary.statistics is not None and summary.statistics.message_count == len(found)
    assert len(summary.metadata_indexes) == summary.statistics.metadata_count
    for chunk in summary.chunk_indexes:
        for channel, offset in chunk.message_index_offsets.items():
            assert content[offset] == 7 and int.from_bytes(content[offset + 9 : offset + 11], "little") == channel
    with Reader(path) as reader:
        assert reader.message_count == len(found)
        assert [(c.topic, time, data) for c, time, data in reader.messages()] == [
            (topic, time, data) for topic, time, _, data in found
        ]
    return found


@examples(150, HealthCheck.function_scoped_fixture)
@given(data=st.data())
def test_a_bag_cut_anywhere_keeps_all_complete_chunks(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "cut.mcap"
    path.unlink(missing_ok=True)
    chunks = data.draw(st.lists(st.lists(st.integers(0, 2), min_size=1, max_size=6), max_size=4))
    messages, flushed = write(path, chunks)
    size = path.stat().st_size
    cut = data.draw(st.integers(0, size - 1))
    with open(path, "r+b") as file:
        file.truncate(cut)

    found = recover(path)
    kept = read(path)
    assert not found.finished and found.messages == len(kept) and kept == messages[: len(kept)]
    assert len(kept) >= max((count for end, count in flushed if end <= cut), default=0)
    whole = path.read_bytes()
    assert recover(path).finished and path.read_bytes() == whole


@examples(40, HealthCheck.function_scoped_fixture)
@given(data=st.data())
def test_a_finished_bag_with_a_damaged_index_keeps_its_messages(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "a.mcap"
    path.unlink(missing_ok=True)
    _, flushed = write(path, [[0, 1], [2]])
    damaged = bytearray(path.read_bytes())
    damaged[data.draw(st.integers(flushed[-1][0], len(damaged) - 1))] ^= data.draw(st.integers(1, 0xFF))
    path.write_bytes(damaged)
    with suppress(BagError):  # numbers that are wrong do not show
        recover(path)
    assert path.read_bytes()[: flushed[-1][0]] == damaged[: flushed[-1][0]]


def test_recovery_cuts_at_the_first_damaged_chunk(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    messages, flushed = write(path, [[0, 1], [2, 0], [1]], close=False)
    damaged = bytearray(path.read_bytes())
    damaged[flushed[1][0] + 60] ^= 0xFF  # within the second chunk
    path.write_bytes(damaged)
    assert recover(path).messages == 2 and read(path) == messages[:2]


def test_a_bag_being_recorded_is_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    bag = Bag(path)
    before = path.read_bytes()
    with pytest.raises(BagError, match="is being recorded; stop the recorder first"):
        recover(path)
    assert path.read_bytes() == before
    bag.close()
    assert recover(path).finished


@pytest.mark.parametrize("content", [b"ROSBAG V2.0\n", b"\x89PNG\r\n"])
def test_a_file_that_is_not_a_bag_is_rejected_and_unchanged(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(BagError, match=r"a\.mcap: not an MCAP file"):
        recover(path)
    assert path.read_bytes() == content
    with pytest.raises(BagError, match=r"none\.mcap: No such file"):
        recover(tmp_path / "none.mcap")


def test_no_bag_is_overwritten(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", [[0]])
    with pytest.raises(FileExistsError):
        Bag(tmp_path / "a.mcap")
