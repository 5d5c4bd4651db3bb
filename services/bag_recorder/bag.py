"""A bag: an MCAP file that stays readable up to the last flush if the writing process is killed."""

import fcntl
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from mcap.writer import CompressionType, Writer

from valor.bags.files import LIBRARY, PROFILE

CHUNK_SIZE = 4 << 20  # before compression [B]; the flush every half second usually ends a chunk earlier
SHARE = 250  # messages processed between two calls of the watchdog
_LOCK_TIMEOUT = 0.5  # [s]


@dataclass(frozen=True, eq=False)
class RecordedTopic:
    """A topic in the bag: ROS type with definition and hash, and the QoS that its publishers offer."""

    name: str
    type: str
    definition: str
    qos: str = ""
    latched: bool = False  # late subscribers receive the last message, so every bag starts with it
    type_hash: str = ""  # hash of the type's description (REP-2011); empty if unavailable


class Sink(Protocol):
    """A receiver of messages."""

    def write(self, topic: RecordedTopic, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Add a message; see ``Bag.write``."""


class _File:
    """An unbuffered, locked file: each write reaches the operating system, and raises its own error.

    The MCAP library would wrap a raw file of ``io`` into a buffer.
    """

    def __init__(self, path: Path) -> None:
        self._raw = open(path, "xb", buffering=0)  # noqa: SIM115  # closed by ``close``
        self.tell, self.close = self._raw.tell, self._raw.close
        deadline = time.monotonic() + _LOCK_TIMEOUT
        while True:
            try:
                fcntl.flock(self._raw, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except BlockingIOError:  # a reader of its state holds the lock for a moment
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.001)

    def write(self, data: bytes) -> int:
        rest = memoryview(data)
        while rest:
            rest = rest[self._raw.write(rest) :]
        return len(data)

    def flush(self) -> None:
        """Do nothing: there is no buffer."""


class Bag:
    """Writes an MCAP file of ROS 2 messages in CDR.

    Messages are collected in a chunk; ``flush`` passes it to the operating system. Flushed messages survive SIGKILL.
    Raises OSError: by the constructor and by every method that writes.
    """

    def __init__(self, path: Path) -> None:
        self.path = path  # the file
        self.written: dict[str, int] = {}  # number of messages by topic
        self._file = _File(path)
        self._writer = Writer(self._file, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
        try:
            self._writer.start(PROFILE, LIBRARY)
        except OSError:  # leave no file of a bag that could not start
            self._file.close()
            path.unlink(missing_ok=True)
            raise
        self._schemas: dict[str, int] = {}
        self._channels: dict[RecordedTopic, int] = {}

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        self._writer.add_metadata(name, values)

    def write(self, topic: RecordedTopic, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Add a message.

        Args:
            topic: of the message; its first message creates the channel.
            log_time: wall clock [ns] by which readers order messages.
            publish_time: of the publication, wall clock [ns].
            sequence: number by the publisher; the lower 32 bits are stored.
            data: CDR with encapsulation.
        """
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._open_channel(topic)
        self._writer.add_message(channel, log_time, data, publish_time, sequence & 0xFFFFFFFF)
        self.written[topic.name] += 1

    @property
    def messages(self) -> int:
        return sum(self.written.values())

    @property
    def size(self) -> int:
        """Size of the file [B]."""
        return self._file.tell()

    def flush(self) -> None:
        """Pass all messages to the operating system."""
        self._writer.flush()

    def close(self) -> None:
        """Write the index and close the file."""
        try:
            self._writer.finish()
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file without an index after a failed write."""
        self._file.close()

    def _open_channel(self, topic: RecordedTopic) -> int:
        schema = self._schemas.get(topic.type)
        if schema is None:
            schema = self._writer.register_schema(topic.type, "ros2msg", topic.definition.encode())
            self._schemas[topic.type] = schema
        # Keys of rosbag2_storage_mcap.
        qos = {"offered_qos_profiles": topic.qos, "topic_type_hash": topic.type_hash}
        metadata = {key: text for key, text in qos.items() if text}
        channel: int = self._writer.register_channel(topic.name, "cdr", schema, metadata)
        self._channels[topic] = channel
        self.written.setdefault(topic.name, 0)
        return channel
