"""One bag as NumPy arrays; a topic is read on first use and stored."""

import logging
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from valor.analysis.reading.ros_types import Types
from valor.bags.errors import BagError
from valor.bags.stored import StoredBag, StoredMessage
from valor.common.arrays import FloatArray
from valor.common.topics import M, Topic

_NANO = 1e-9
_log = logging.getLogger(__name__)


class Series:
    """All messages of one topic, in recorded order."""

    def __init__(
        self, topic: str, type_name: str, messages: Sequence[Any], received: FloatArray, sent: FloatArray
    ) -> None:
        self.topic = topic
        self.type = type_name  # ROS type, such as ``valor_msgs/msg/Motor``
        self.messages = messages  # n, with the fields of the type
        self.received, self.sent = received, sent  # (n,) by the recorder; by the publisher, wall clock [s]
        self._columns: dict[str, FloatArray] = {}

    @classmethod
    def from_messages(cls, topic: Topic[M], messages: Sequence[M]) -> Self:
        """Messages of a Bifrost topic received live, without a bag; at least one."""
        return cls(topic.name, topic.type.__name__, messages, np.empty(0), np.empty(0))

    def __len__(self) -> int:
        return len(self.messages)

    @cached_property
    def time(self) -> FloatArray:
        """(n,) robot time [s]: from the field ``time``, else the header's stamp, else the time of reception."""
        if hasattr(self.messages[0], "time"):
            return _NANO * self["time"]
        if hasattr(self.messages[0], "header"):
            return self["header.stamp.sec"] + _NANO * self["header.stamp.nanosec"]
        return self.received

    def __getitem__(self, field: str) -> FloatArray:
        """A field as (n,), or as (n, k) if each message holds k numbers; ``a.b`` is a field of a sub-message.

        Raises BagError: there is no such field, or its length differs between messages.
        """
        if field not in self._columns:
            try:
                self._columns[field] = np.array([_get(message, field) for message in self.messages], dtype=np.float64)
            except AttributeError:
                raise BagError(f"{self.topic}: {self.type} has no field {field!r}") from None
            except ValueError:
                raise BagError(f"{self.topic}: {field!r} has another length in some messages") from None
        return self._columns[field]

    def strings(self, field: str) -> npt.NDArray[np.str_]:
        """A text field, as (n,)."""
        return np.array([_get(message, field) for message in self.messages])

    def by_joint(
        self, field: str = "position", times: FloatArray | None = None
    ) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Times [s] and values by joint, of messages with joint names; ``times``: (n,) instead of ``time``."""
        key = "names" if hasattr(self.messages[0], "names") else "name"
        found: dict[str, list[tuple[float, float]]] = {}
        for time, message in zip(self.time if times is None else times, self.messages, strict=True):
            for joint, value in zip(getattr(message, key), getattr(message, field).tolist(), strict=False):
                found.setdefault(joint, []).append((time, value))
        columns = {joint: np.array(pairs).T for joint, pairs in found.items()}
        return {joint: (times_of, values) for joint, (times_of, values) in columns.items()}


class Bag:
    """A bag, an MCAP file or a folder of them, opened for reading. Raises ``BagError``: there is none.

    ``truncated`` states after the first read whether the file is cut off.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.truncated = False
        self._series: dict[str, Series] = {}
        self._types = Types()
        StoredBag(path)  # raises BagError if there is none

    @classmethod
    def of(cls, bag: Self | Path) -> Self:
        """Return a bag as it is, or open a file."""
        return bag if isinstance(bag, cls) else cls(Path(str(bag)))

    @cached_property
    def topics(self) -> dict[str, str]:
        """ROS types by topic, of topics with messages."""
        return {each.topic.name: each.topic.type for each in self._messages()}

    @cached_property
    def origin(self) -> dict[str, str]:
        """The recorder's notes: robot, world, seed, …; empty in a bag of another recorder."""
        stored = StoredBag(self.path)
        next(stored.messages(), None)  # the notes precede all messages
        return stored.condition.origin

    def __contains__(self, topic: str) -> bool:
        return topic in self._series or topic in self.topics

    def __getitem__(self, topic: str) -> Series:
        """All messages of a topic. Raises ``BagError``: the bag has none; lists its topics."""
        self.load(topic)
        return self._series[topic]

    def load(self, *topics: str) -> None:
        """Read several topics in one pass. Raises BagError: one is missing, or the damage is not just a missing end."""
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
        """All messages; of a truncated bag those before the cut."""
        stored = StoredBag(self.path)
        yield from stored.messages()
        condition = stored.condition
        if len(condition.damage) > condition.truncated:
            raise BagError(f"damaged: {condition.damage[0]}; expected a complete or truncated bag")
        if condition.truncated and not self.truncated:
            _log.warning("%s: truncated; the messages before the cut are used", self.path)
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
