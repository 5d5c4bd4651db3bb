"""The recorder's shorter way to add a message against the MCAP library's own."""

from __future__ import annotations

import tracemalloc
from io import BytesIO
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from harness.examples import examples
from valor.bag_recorder.quick_writer import QuickWriter

U32, U64 = st.integers(0, 2**32 - 1), st.integers(0, 2**64 - 1)
MESSAGES = st.lists(st.tuples(st.integers(1, 3), U64, st.binary(max_size=300), U64, U32), max_size=60)


def written(kind: type[Writer], messages: list[tuple[int, int, bytes, int, int]], flush_at: int) -> bytes:
    """A file of messages, with chunks of 1 kB, one of them handed on early."""
    out = BytesIO()
    writer: Any = kind(out, chunk_size=1000, compression=CompressionType.ZSTD)
    writer.start("ros2", "test")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    for i in range(3):
        assert writer.register_channel(f"/topic_{i}", "cdr", schema, {"offered_qos_profiles": "[]"}) == i + 1
    for i, message in enumerate(messages):
        writer.add_message(*message)
        if i == flush_at:
            writer.flush()
            writer.add_metadata("note", {"at": str(i)})
    writer.finish()
    return out.getvalue()


@examples(60)
@given(MESSAGES, st.integers(0, 60))
def test_what_comes_out_is_the_librarys_byte_for_byte(
    messages: list[tuple[int, int, bytes, int, int]], flush_at: int
) -> None:
    assert written(QuickWriter, messages, flush_at) == written(Writer, messages, flush_at)


class _Nowhere:
    """Takes everything, keeps nothing."""

    def __init__(self) -> None:
        self._position = 0

    def write(self, data: bytes) -> int:
        self._position += len(data)
        return len(data)

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Nothing is held back."""


def kept(kind: type[Writer], chunks: int, topics: int = 40) -> int:
    """Memory [B] by which a writer grows in so many chunks, each with a message of every topic."""
    writer: Any = kind(_Nowhere(), compression=CompressionType.NONE)
    writer.start("ros2", "test")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    channels = [writer.register_channel(f"/topic_{i}", "cdr", schema, {}) for i in range(topics)]

    def write(count: int) -> None:
        for i in range(count):
            for channel in channels:
                writer.add_message(channel, 10**18 + i, b"", 10**18 + i)
            writer.flush()

    write(10)
    tracemalloc.start()
    try:
        write(chunks)
        return tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()


def test_what_is_written_leaves_little_behind_in_memory() -> None:
    assert kept(QuickWriter, 200) < kept(Writer, 200) / 4
