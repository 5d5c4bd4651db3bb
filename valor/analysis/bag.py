"""One bag as NumPy arrays, topic by topic.

A topic is read when it is first asked for, and kept. A bag whose writer was killed ends without an index: what was
written before is read all the same.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from valor.analysis.ros_types import Types
from valor.bags.errors import BagError
from valor.bags.stored import StoredBag, StoredMessage
from valor.common.arrays import FloatArray
from valor.common.topics import M, Topic

_NANO = 1e-9
_log = logging.getLogger(__name__)


class Series:
    """All messages of one topic, in the order in which they were recorded.

    Attributes:
        topic: its name.
        type: ROS type, such as ``valor_msgs/msg/Motor``.
        messages: with the fields of the type, n of them.
        received: (n,) when the recorder had them, wall clock [s].
        sent: (n,) when they were published, wall clock [s].
    """

    def __init__(
        self, topic: str, type_name: str, messages: Sequence[Any], received: FloatArray, sent: FloatArray
    ) -> None:
        self.topic = topic
        self.type = type_name
        self.messages = messages
        self.received = received
        self.sent = sent
        self._columns: dict[str, FloatArray] = {}
        self._by_joint: dict[str, dict[str, tuple[npt.NDArray[np.intp], FloatArray]]] = {}

    @classmethod
    def heard(cls, topic: Topic[M], messages: Sequence[M]) -> Self:
        """Messages of a Bifrost topic that an observer kept, and did not record; at least one."""
        return cls(topic.name, topic.type.__name__, messages, np.empty(0), np.empty(0))

    def __len__(self) -> int:
        return len(self.messages)

    @cached_property
    def time(self) -> FloatArray:
        """(n,) robot time [s]: of the field ``time``, else the header's stamp, else when it was received."""
        if hasattr(self.messages[0], "time"):
            return _NANO * self["time"]
        if hasattr(self.messages[0], "header"):
            return self["header.stamp.sec"] + _NANO * self["header.stamp.nanosec"]
        return self.received

    def __getitem__(self, field: str) -> FloatArray:
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

    def by_joint(
        self, field: str = "position", times: FloatArray | None = None
    ) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Of messages that carry joint names with their values: times [s] and values, by joint.

        Args:
            field: of the values.
            times: (n,) of the messages; ``time`` unless given.
        """
        if field not in self._by_joint:
            key = "names" if hasattr(self.messages[0], "names") else "name"
            rows: dict[str, list[int]] = {}
            values: dict[str, list[float]] = {}
            for i, message in enumerate(self.messages):
                for joint, value in zip(getattr(message, key), getattr(message, field).tolist(), strict=False):
                    rows.setdefault(joint, []).append(i)
                    values.setdefault(joint, []).append(value)
            self._by_joint[field] = {
                joint: (np.array(rows[joint], dtype=np.intp), np.array(values[joint])) for joint in rows
            }
        at = self.time if times is None else times
        return {joint: (at[rows], values) for joint, (rows, values) in self._by_joint[field].items()}


class Bag:
    """A bag, opened for reading: an MCAP or SQLite file, or a folder of them.

    Attributes:
        path: as given.
        truncated: it ends in the middle; known once something was read.

    Raises:
        BagError: by the constructor: there is no bag.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.truncated = False
        self._series: dict[str, Series] = {}
        self._types = Types()
        StoredBag(path)  # complains if there is none

    @classmethod
    def of(cls, bag: Bag | Path) -> Bag:
        """A bag, or the bag in a file."""
        return bag if isinstance(bag, cls) else cls(Path(str(bag)))

    @cached_property
    def topics(self) -> dict[str, str]:
        """Topics with messages, and their ROS types."""
        return {each.topic.name: each.topic.type for each in self._messages()}

    @cached_property
    def origin(self) -> dict[str, str]:
        """What the recorder noted of the system: robot, world, seed, …; empty in a bag of another recorder."""
        stored = StoredBag(self.path)
        next(stored.messages(), None)  # it stands before all
        return stored.condition.origin

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
            BagError: the bag lacks one of them, or is damaged otherwise than by a missing end.
        """
        wanted = [topic for topic in topics if topic not in self._series]
        if not wanted:
            return
        messages: dict[str, list[Any]] = {topic: [] for topic in wanted}
        stamps: dict[str, list[tuple[int, int]]] = {topic: [] for topic in wanted}
        types: dict[str, str] = {}
        for message in self._messages():
            name = message.topic.name
            if name in messages:
                types[name] = message.topic.type
                messages[name].append(self._decode(message))
                stamps[name].append((message.received, message.sent))
        for name in wanted:
            if name not in types:
                known = ", ".join(sorted(self.topics)) or "no messages at all"
                raise BagError(f"{self.path}: no messages on {name}; the bag has {known}")
            received, sent = _NANO * np.array(stamps[name], dtype=np.float64).T
            self._series[name] = Series(name, types[name], messages[name], received, sent)

    def _messages(self) -> Iterator[StoredMessage]:
        """All of them; a bag that is cut off is read to where it was written."""
        stored = StoredBag(self.path)
        yield from stored.messages()
        condition = stored.condition
        if len(condition.damage) > condition.truncated:
            raise BagError(f"damaged: {condition.damage[0]}; expected a bag that is whole, or cut off at its end")
        if condition.truncated and not self.truncated:
            _log.warning("%s: ends in the middle; what was written before is used", self.path)
        self.truncated = condition.truncated > 0

    def _decode(self, message: StoredMessage) -> Any:
        try:
            return self._types.decode(message.topic, message.data)
        except BagError as error:
            raise BagError(f"{self.path}: {error}") from None


def _get(message: Any, field: str) -> Any:
    for name in field.split("."):
        message = getattr(message, name)
    return message
