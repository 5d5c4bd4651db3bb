"""Large messages of constant layout, serialized once.

Filling forty transforms field by field and serializing them takes rclpy half a millisecond. Strings and lengths never
change from one such message to the next, so the numbers always stand at the same places: they are found once, by
serializing the message with numbers that occur nowhere else, and then written where they stand. What is published is
what rclpy would have made of the message (CDR, little-endian).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

from valor.common.arrays import FloatArray

_ENCAPSULATION = 4  # bytes before the body; alignment counts from its end
_MARK = 1e200  # no coordinate
_SECONDS, _NANOSECONDS = 0x5EC05EC0, 0x7A707A70


class PreparedMessage:
    """The serialized form of a message whose numbers change.

    Make it of a message whose varying float64 fields hold ``mark(0)``, ``mark(1)``, … and whose stamps hold
    ``stamp_mark()``.

    Attributes:
        values: (count,) to be written before ``serialized``.
    """

    def __init__(self, message: Any, count: int) -> None:
        """Find the ``count`` marked numbers and the stamps.

        Raises:
            ValueError: a mark is missing or stands twice.
        """
        raw = _serialized(message)
        padded = len(raw) + (-(len(raw) - _ENCAPSULATION)) % 8
        self._bytes = bytearray(raw.ljust(padded, b"\0"))
        self._length = len(raw)
        self._numbers = np.frombuffer(self._bytes, "<f8", offset=_ENCAPSULATION)
        words = np.frombuffer(self._bytes, "<u4", offset=_ENCAPSULATION)
        order = np.argsort(self._numbers, kind="stable")
        marks = np.array([mark(i) for i in range(count)])
        found = np.searchsorted(self._numbers[order], marks)
        self._places = order[np.minimum(found, len(order) - 1)]
        if not np.array_equal(self._numbers[self._places], marks) or np.isin(self._numbers, marks).sum() != count:
            raise ValueError(f"expected {count} marked numbers, each once, in {type(message).__name__}")
        self._seconds = np.flatnonzero((words[:-1] == _SECONDS) & (words[1:] == _NANOSECONDS))
        self._words = words
        self.values: FloatArray = np.zeros(count)

    def serialized(self, stamp: Time) -> bytes:
        """The message with the present ``values``, stamped."""
        self._numbers[self._places] = self.values
        self._words[self._seconds] = stamp.sec
        self._words[self._seconds + 1] = stamp.nanosec
        return bytes(memoryview(self._bytes)[: self._length])


class PreparedPublisher:
    """Publishes one prepared message, on several topics as on one.

    Attributes:
        values: (count,) to be written before ``publish``.
    """

    def __init__(self, node: Node, topics: Sequence[str], message: Any, count: int, *, stamp: Time, queue: int) -> None:
        """Open the topics.

        Args:
            node: the ROS node.
            topics: names of it; serialized once, published where somebody listens if there are several.
            message: with ``count`` marks, as of ``PreparedMessage``.
            count: of them.
            stamp: robot time, kept up to date by its owner.
            queue: depth of the topics.
        """
        self._message = PreparedMessage(message, count)
        self._stamp = stamp
        self._publishers = [node.create_publisher(type(message), topic, queue) for topic in topics]
        self.values = self._message.values

    @property
    def heard(self) -> bool:
        """Whether somebody listens."""
        return any(publisher.get_subscription_count() for publisher in self._publishers)

    def publish(self) -> None:
        """Publish the present ``values``, stamped."""
        serialized = self._message.serialized(self._stamp)
        for publisher in self._publishers:
            if len(self._publishers) == 1 or publisher.get_subscription_count():
                publisher.publish(serialized)


def _serialized(message: Any) -> bytes:
    """The message's own bytes.

    What rclpy returns is as long as the middleware reckons that a message may become, which is too long where
    sequences are empty; the rest is whatever stood there in memory. Strict readers refuse such a message.
    """
    raw = bytes(serialize_message(message))
    while True:
        try:
            deserialize_message(raw[:-1], type(message))
        except Exception:  # rclpy's own type is not public
            return raw
        raw = raw[:-1]


def mark(i: int) -> float:
    """Stands for the i-th varying number."""
    return _MARK * (1 + i)


def stamp_mark() -> Time:
    """Stands for the stamp."""
    return Time(sec=_SECONDS, nanosec=_NANOSECONDS)
