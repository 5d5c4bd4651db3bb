"""One MCAP bag as NumPy arrays, topic by topic.

A topic is read when it is first asked for, and kept. A bag whose writer was killed ends without an index: what was
written before is read all the same.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from valor_analysis.errors import BagError

Array = npt.NDArray[np.float64]
_NANO = 1e-9
_log = logging.getLogger(__name__)


class Series:
    """All messages of one topic, in the order in which they were recorded.

    Attributes:
        topic: its name.
        type: ROS type, such as ``valor_msgs/msg/Motor``.
        messages: with the fields of the type, n of them.
        received: (n,) when the recorder had them, wall clock [s].
    """

    def __init__(self, topic: str, type_name: str, messages: Sequence[Any], received: Array) -> None:
        self.topic = topic
        self.type = type_name
        self.messages = messages
        self.received = received
        self._columns: dict[str, Array] = {}
        self._by_joint: dict[str, dict[str, tuple[Array, Array]]] = {}

    def __len__(self) -> int:
        return len(self.messages)

    @cached_property
    def time(self) -> Array:
        """(n,) robot time [s]: of the field ``time``, else the header's stamp, else when it was received."""
        if hasattr(self.messages[0], "time"):
            return _NANO * self["time"]
        if hasattr(self.messages[0], "header"):
            return self["header.stamp.sec"] + _NANO * self["header.stamp.nanosec"]
        return self.received

    def __getitem__(self, field: str) -> Array:
        """A field as (n,), or as (n, k) where each message holds k numbers. ``a.b`` reaches into sub-messages.

        Raises:
            BagError: no such field, or it has not the same length in every message.
        """
        if field not in self._columns:
            try:
                self._columns[field] = np.array([_get(message, field) for message in self.messages], dtype=np.float64)
            except AttributeError:
                raise BagError(f"{self.topic}: {self.type} has no field {field!r}") from None
            except ValueError:
                raise BagError(f"{self.topic}: {field!r} is not the same number of numbers in every message") from None
        return self._columns[field]

    def strings(self, field: str) -> npt.NDArray[np.str_]:
        """A field of text, as (n,)."""
        return np.array([_get(message, field) for message in self.messages])

    def by_joint(self, field: str = "position") -> dict[str, tuple[Array, Array]]:
        """Of messages that carry joint names with their values: times [s] and values, by joint."""
        if field not in self._by_joint:
            key = "names" if hasattr(self.messages[0], "names") else "name"
            times: dict[str, list[float]] = {}
            values: dict[str, list[float]] = {}
            for at, message in zip(self.time.tolist(), self.messages, strict=True):
                for joint, value in zip(getattr(message, key), getattr(message, field).tolist(), strict=False):
                    times.setdefault(joint, []).append(at)
                    values.setdefault(joint, []).append(value)
            self._by_joint[field] = {joint: (np.array(times[joint]), np.array(values[joint])) for joint in times}
        return self._by_joint[field]


class Bag:
    """An MCAP bag, opened for reading.

    Attributes:
        path: the file.
        truncated: the file ends in the middle; known once something was read.

    Raises:
        BagError: by the constructor: there is no such file, or it is no MCAP bag.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.truncated = False
        self._series: dict[str, Series] = {}
        self._store = get_typestore(Stores.EMPTY)
        try:
            with open(path, "rb") as file:
                magic = file.read(5)
        except OSError as error:
            raise BagError(f"{path}: {error.strerror}; expected an MCAP bag") from None
        if magic != b"\x89MCAP":
            raise BagError(f"{path}: not an MCAP bag")

    @classmethod
    def of(cls, bag: Bag | Path) -> Bag:
        """A bag, or the bag in a file."""
        return bag if isinstance(bag, cls) else cls(Path(str(bag)))

    @cached_property
    def topics(self) -> dict[str, str]:
        """Topics with messages, and their ROS types."""
        return {channel.topic: schema.name for channel, schema, _ in self._records(None)}

    @cached_property
    def origin(self) -> dict[str, str]:
        """What the recorder noted of the system: robot, world, seed, …; empty in a bag of another recorder."""
        with open(self.path, "rb") as file, contextlib.suppress(McapError, ValueError, KeyError, OverflowError):
            for record in StreamReader(file).records:
                if isinstance(record, Metadata) and record.name == "valor":
                    return dict(record.metadata)
                if isinstance(record, Message):  # it stands before all
                    break
        return {}

    def __contains__(self, topic: str) -> bool:
        return topic in self._series or topic in self.topics

    def __getitem__(self, topic: str) -> Series:
        """All messages of a topic.

        Raises:
            BagError: the bag has none; says what it has.
        """
        self.load(topic)
        return self._series[topic]

    def load(self, *topics: str) -> None:
        """Read several topics in one pass.

        Raises:
            BagError: the bag lacks one of them, or is broken.
        """
        wanted = [topic for topic in topics if topic not in self._series]
        if not wanted:
            return
        data: dict[str, list[bytes]] = {topic: [] for topic in wanted}
        received: dict[str, list[int]] = {topic: [] for topic in wanted}
        types: dict[str, Schema] = {}
        for channel, schema, message in self._records(wanted):
            types[channel.topic] = schema
            data[channel.topic].append(message.data)
            received[channel.topic].append(message.log_time)
        for topic in wanted:
            if topic not in types:
                known = ", ".join(sorted(self.topics)) or "no messages at all"
                raise BagError(f"{self.path}: no messages on {topic}; the bag has {known}")
            stamps = _NANO * np.array(received[topic], dtype=np.float64)
            self._series[topic] = Series(
                topic, types[topic].name, self._decode(topic, types[topic], data[topic]), stamps
            )

    def _records(self, topics: Sequence[str] | None) -> Iterator[tuple[Channel, Schema, Message]]:
        """Messages of some topics, or of all, with their channels and schemas."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        with open(self.path, "rb") as file:
            try:
                for record in StreamReader(file).records:
                    if isinstance(record, Message):
                        channel = channels.get(record.channel_id)
                        if channel is not None:
                            yield channel, schemas[channel.schema_id], record
                    elif isinstance(record, Schema):
                        schemas[record.id] = record
                    elif isinstance(record, Channel) and (topics is None or record.topic in topics):
                        channels[record.id] = record
            except EndOfFile:
                if not self.truncated:
                    _log.warning("%s: ends in the middle; what was written before is used", self.path)
                self.truncated = True
            except (McapError, ValueError, KeyError, OverflowError, MemoryError, OSError) as error:
                raise BagError(f"{self.path}: broken MCAP: {' '.join(str(error).split())}") from None
            except Exception as error:  # the decompressors raise classes of their own
                raise BagError(f"{self.path}: broken MCAP chunk: {' '.join(str(error).split())}") from None

    def _decode(self, topic: str, schema: Schema, data: list[bytes]) -> list[Any]:
        try:
            if schema.name not in self._store.fielddefs:
                types = get_types_from_msg(schema.data.decode(), schema.name)
                self._store.register(
                    {name: type_ for name, type_ in types.items() if name not in self._store.fielddefs}
                )
            return [self._store.deserialize_cdr(raw, schema.name) for raw in data]
        except (SerdeError, TypesysError, UnicodeDecodeError) as error:
            text = " ".join(str(error).split())
            raise BagError(f"{self.path}: {topic}: messages are not {schema.name}: {text}") from None


def _get(message: Any, field: str) -> Any:
    for name in field.split("."):
        message = getattr(message, name)
    return message
