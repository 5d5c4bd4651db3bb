"""Large messages of constant layout, serialized once.

rclpy takes a quarter of a millisecond to fill and serialize forty transforms. Strings and lengths are constant, so the
numbers keep their positions: these are found once, by serializing the message with unique marks. The result equals
rclpy's serialization (CDR, little-endian).
"""

from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.serialization import serialize_message

from valor.common.arrays import FloatArray

_ENCAPSULATION = 4  # bytes before the body; alignment counts from its end
_MARK = 1e200  # not a coordinate
_SECONDS, _NANOSECONDS = 0x5EC05EC0, 0x7A707A70


class PreparedMessage:
    """Serialized message with variable numbers.

    Its source has float64 fields ``mark(0)``, ``mark(1)``, … and stamps ``stamp_mark()``. No sequence is empty: rclpy
    would append uninitialised bytes.
    """

    def __init__(self, message: Any, count: int) -> None:
        """Find the ``count`` marked numbers and the stamps. Raises ValueError: a mark is missing or occurs twice."""
        raw = bytes(serialize_message(message))
        self._length = len(raw)
        self._bytes = bytearray(raw + bytes(-(len(raw) - _ENCAPSULATION) % 8))
        self._numbers = np.frombuffer(self._bytes, "<f8", offset=_ENCAPSULATION)
        self._words = np.frombuffer(self._bytes, "<u4", offset=_ENCAPSULATION)
        index = {number: i for i, number in enumerate(self._numbers.tolist())}
        marks = [mark(i) for i in range(count)]
        if not index.keys() >= {*marks} or np.isin(self._numbers, marks).sum() != count:
            raise ValueError(f"expected {count} marked numbers, each once, in {type(message).__name__}")
        self._places = np.array([index[number] for number in marks])
        self._seconds = np.flatnonzero((self._words[:-1] == _SECONDS) & (self._words[1:] == _NANOSECONDS))
        self.values: FloatArray = np.zeros(count)  # (count,) written before ``serialized``

    def serialized(self, stamp: Time) -> bytes:
        """Message with the current ``values`` and a stamp."""
        self._numbers[self._places] = self.values
        self._words[self._seconds] = stamp.sec
        self._words[self._seconds + 1] = stamp.nanosec
        return bytes(memoryview(self._bytes)[: self._length])


class PreparedPublisher:
    """Publishes a prepared message."""

    def __init__(self, node: Node, topic: str, message: Any, count: int, *, stamp: Time, queue: int) -> None:
        """``message``: with ``count`` marks, see ``PreparedMessage``; ``stamp``: robot time, updated by its owner."""
        self._message, self._stamp = PreparedMessage(message, count), stamp
        self._publisher = node.create_publisher(type(message), topic, queue)
        self.values = self._message.values  # (count,) written before ``publish``

    def publish(self) -> None:
        self._publisher.publish(self._message.serialized(self._stamp))


def mark(i: int) -> float:
    """Mark of the i-th variable number."""
    return _MARK * (1 + i)


def stamp_mark() -> Time:
    return Time(sec=_SECONDS, nanosec=_NANOSECONDS)
