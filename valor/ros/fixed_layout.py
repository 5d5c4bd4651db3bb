"""Messages whose strings and lengths are those of the last: their numbers are written and read where they stand.

Of a message of some hundred bytes rclpy makes a Python object a field, and of each of those an object of C, which costs
more than to send it does. In a stream of them only the numbers change, so they stand at the same places: those that CDR
(little-endian) gives them. A message that is laid out otherwise is for rclpy; it is the pattern of the next ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt
from rclpy.serialization import deserialize_message, serialize_message

_ENCAPSULATION = 4  # bytes before the body; alignment counts from its end
_LITTLE_ENDIAN = b"\0\1"  # what it begins with
_KINDS = {
    "boolean": "u1",
    "octet": "u1",
    "uint8": "u1",
    "int8": "i1",
    **{f"{sign}int{8 * size}": f"<{sign or 'i'}{size}" for sign in ("", "u") for size in (2, 4, 8)},
    "float": "<f4",
    "double": "<f8",
}

M = TypeVar("M")


class Layout:
    """Where the numbers of a message stand, and the message.

    Attributes:
        numbers: by field, as ``header.stamp.sec``: all in ``bytes``, to be read and written, a single one as (1,).
    """

    def __init__(self, message: Any) -> None:
        """As a message has it.

        Raises:
            ValueError: it has a field of another kind than numbers, strings, sequences of numbers and messages of them.
        """
        self.numbers: dict[str, npt.NDArray[Any]] = {}
        self._same: list[tuple[slice, bytes]] = []  # what is no number: lengths and strings
        self._end = _ENCAPSULATION
        fields = list(self._walk(message, ""))
        self.bytes = bytearray(bytes(serialize_message(message))[: self._end])
        for name, kind, count, place in fields:
            self.numbers[name] = np.frombuffer(self.bytes, kind, count, place if count else 0)

    def _walk(self, message: Any, path: str) -> Iterator[tuple[str, np.dtype[Any], int, int]]:
        """Of each field with numbers: name, type, how many, and where they begin."""
        for name, kind in message.get_fields_and_field_types().items():
            value, count = getattr(message, name), 1
            if hasattr(value, "get_fields_and_field_types"):
                yield from self._walk(value, f"{path}{name}.")
                continue
            if isinstance(value, str):
                text = value.encode() + b"\0"
                self._fixed(len(text), text)
                continue
            if kind.startswith("sequence<"):
                count = len(value)
                self._fixed(count)
            element = kind.removeprefix("sequence<").removesuffix(">")
            if element not in _KINDS:
                raise ValueError(f"{path}{name}: {kind}; expected numbers, strings and sequences of numbers")
            dtype = np.dtype(_KINDS[element])
            if count:
                self._align(dtype.itemsize)
            yield f"{path}{name}", dtype, count, self._end
            self._end += count * dtype.itemsize

    def _align(self, size: int) -> None:
        self._end += -(self._end - _ENCAPSULATION) % size

    def _fixed(self, length: int, text: bytes = b"") -> None:
        self._align(4)
        content = length.to_bytes(4, "little") + text
        self._same.append((slice(self._end, self._end + len(content)), content))
        self._end += len(content)

    def stamp(self, time: int) -> None:
        """Of the message's header [ns]."""
        self.numbers["header.stamp.sec"][0], self.numbers["header.stamp.nanosec"][0] = divmod(time, 1_000_000_000)

    def read(self, raw: bytes) -> bool:
        """Take a message's numbers over; returns whether it is laid out so. What stands behind it is nothing."""
        if len(raw) < self._end or raw[:2] != _LITTLE_ENDIAN:
            return False
        for place, content in self._same:
            if raw[place] != content:
                return False
        self.bytes[:] = raw[: self._end]
        return True


class Stream(Generic[M]):
    """Messages of one type, one after another, as the layouts of the last ones have them."""

    def __init__(self, message_type: type[M]) -> None:
        self._type = message_type
        self._layout: Layout | None = None

    def received(self, raw: bytes) -> dict[str, npt.NDArray[Any]]:
        """A message's numbers, until the next one comes.

        Raises:
            Exception: rclpy's, of bytes that are no such message.
        """
        if self._layout is None or not self._layout.read(raw):
            self._layout = Layout(deserialize_message(raw, self._type))
        return self._layout.numbers
