"""One bag: an MCAP file that is readable up to its last second whatever happens to the process that writes it."""

from __future__ import annotations

import fcntl
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from mcap.writer import CompressionType

from valor.bag_recorder.quick_writer import QuickWriter
from valor.bags.files import LIBRARY, PROFILE

CHUNK_SIZE = 1 << 20  # [B] before compression; a second of recording is usually more
SHARE = 250  # messages that are taken from a topic between two signs of life
_LOCK_PATIENCE = 0.5  # [s]


@dataclass(frozen=True, eq=False)
class RecordedTopic:
    """A topic as the bag knows it: ROS type, its definition and hash, and the QoS that its publishers offered.

    Attributes:
        latched: whoever comes late still gets the last message, so every bag begins with it.
        type_hash: of the type's description (REP-2011); empty: not known.
    """

    name: str
    type: str
    definition: str
    qos: str = ""
    latched: bool = False
    type_hash: str = ""


class Sink(Protocol):
    """Where messages go."""

    def write(self, topic: RecordedTopic, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Add a message; see ``Bag.write``."""


class _File:
    """A file without a buffer of its own: what is written is the system's at once, and an error is told at once."""

    def __init__(self, path: Path) -> None:
        self._raw = open(path, "xb", buffering=0)  # noqa: SIM115  # closed by ``close``
        self._lock()
        self._position = 0

    def write(self, data: bytes) -> int:
        rest = memoryview(data)
        while rest:
            written = self._raw.write(rest)
            self._position += written
            rest = rest[written:]
        return len(data)

    def tell(self) -> int:
        return self._position

    def _lock(self) -> None:
        """Tell others that somebody writes. Whoever looks just then whether somebody does holds it for a moment."""
        deadline = time.monotonic() + _LOCK_PATIENCE
        while True:
            try:
                fcntl.flock(self._raw, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.001)

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        self._raw.close()


class Bag:
    """Writes an MCAP file of ROS 2 messages in CDR.

    Messages gather in a chunk; ``flush`` hands it to the system. What was flushed outlives SIGKILL.

    Attributes:
        path: the file.
        written: messages so far, by topic.

    Raises:
        OSError: by the constructor and by every method that writes.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.written: dict[str, int] = {}
        self._file = _File(path)
        self._writer = QuickWriter(self._file, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
        try:
            self._writer.start(PROFILE, LIBRARY)
        except OSError:  # no trace of a bag that could not begin
            self._file.close()
            path.unlink(missing_ok=True)
            raise
        self._schemas: dict[str, int] = {}
        self._channels: dict[RecordedTopic, int] = {}

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        self._writer.add_metadata(name, values)

    def write(self, topic: RecordedTopic, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Add a message.

        Args:
            topic: its topic; the channel is made at its first message.
            log_time: wall clock [ns] by which readers order it.
            publish_time: wall clock [ns] of its publication.
            sequence: the publisher's count; the lower 32 bits are kept.
            data: CDR with its encapsulation.
        """
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._open_channel(topic)
        self._writer.add_message(channel, log_time, data, publish_time, sequence & 0xFFFFFFFF)
        self.written[topic.name] += 1

    @property
    def messages(self) -> int:
        """Written so far."""
        return sum(self.written.values())

    @property
    def size(self) -> int:
        """Of the file so far [B]."""
        return self._file.tell()

    def flush(self) -> None:
        """Hand everything so far to the system."""
        self._writer.flush()

    def close(self) -> None:
        """Write the index and close the file."""
        try:
            self._writer.finish()
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file as it is, without an index: writing failed."""
        self._file.close()

    def _open_channel(self, topic: RecordedTopic) -> int:
        schema = self._schemas.get(topic.type)
        if schema is None:
            schema = self._writer.register_schema(topic.type, "ros2msg", topic.definition.encode())
            self._schemas[topic.type] = schema
        # As rosbag2_storage_mcap names them.
        told = {"offered_qos_profiles": topic.qos, "topic_type_hash": topic.type_hash}
        metadata = {key: text for key, text in told.items() if text}
        channel: int = self._writer.register_channel(topic.name, "cdr", schema, metadata)
        self._channels[topic] = channel
        self.written.setdefault(topic.name, 0)
        return channel
