"""Bifrost messages as CDR of their ROS twins (``valor_msgs``), without making ROS message objects.

A twin is ``std_msgs/Header header``, ``uint64 bifrost_sequence``, then the fields of the Bifrost message. CDR
(OMG XCDR version 1, little-endian) aligns every number to its size, counted from after the four bytes that say which
CDR it is. Where the padding goes depends on the lengths of strings and arrays alone, so that one ``struct.Struct`` per
combination of lengths packs a whole message at once; a topic has few combinations, and arrays go in as bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from enum import Enum
from operator import attrgetter
from typing import Any

from bifrost import Message, Received, codec

PACKAGE = "valor_msgs"
_ENCAPSULATION = b"\x00\x01\x00\x00"  # CDR, little-endian, no options
_SECOND = 1_000_000_000


class _Kind(Enum):
    """Of a field, as Bifrost's schemas call it."""

    BOOL = "bool"
    INT = "int"
    FLOAT = "float"
    STRING = "str"
    STRINGS = "list<str>"
    BYTES = "uint8[]"
    FLOATS = "float64[]"


_NUMBERS = {_Kind.BOOL: ("?", 1), _Kind.INT: ("q", 8), _Kind.FLOAT: ("d", 8)}  # code in a format, and size [B]


def twin_type(message_type: type[Message]) -> str:
    """The name of the ROS twin, as ``valor_msgs/msg/Motor``."""
    return f"{PACKAGE}/msg/{message_type.__name__}"


class TwinEncoder:
    """Encodes the messages of one Bifrost type.

    Raises:
        TypeError: a field's type has no twin; names the field.
    """

    LAYOUTS = 256  # kept; free text makes ever new lengths

    def __init__(self, message_type: type[Message]) -> None:
        self._kinds: list[_Kind] = []
        for name, type_name in codec(message_type).schema.types[message_type.__name__]:
            try:
                self._kinds.append(_Kind(type_name))
            except ValueError:
                raise TypeError(f"{message_type.__name__}.{name}: {type_name} has no ROS twin") from None
        names = message_type.__struct_fields__
        self._values: Callable[[Message], tuple[Any, ...]] = (
            attrgetter(*names) if len(names) > 1 else lambda message: tuple(getattr(message, n) for n in names)
        )
        self._pack: dict[tuple[int, ...], Callable[..., bytes]] = {}

    def encode(self, received: Received[Any], stamp: int) -> bytes:
        """The twin of a message, with its encapsulation.

        Args:
            received: the message with its envelope.
            stamp: for the header: when it was published, on the wall clock [ns].

        Raises:
            struct.error: an integer does not fit 64 signed bits.
        """
        origin = received.origin.encode()
        seconds, nanoseconds = divmod(stamp, _SECOND)
        lengths = [len(origin)]
        packed: list[Any] = [
            _ENCAPSULATION, seconds, nanoseconds, len(origin) + 1, origin, received.sequence,
        ]  # fmt: skip
        for kind, value in zip(self._kinds, self._values(received.message), strict=True):
            if kind is _Kind.FLOATS or kind is _Kind.BYTES:
                lengths.append(len(value))
                packed.append(len(value))
                packed.append(value.tobytes())
            elif kind is _Kind.STRING:
                text = value.encode()
                lengths.append(len(text))
                packed.append(len(text) + 1)
                packed.append(text)
            elif kind is _Kind.STRINGS:
                lengths.append(len(value))
                packed.append(len(value))
                for each in value:
                    text = each.encode()
                    lengths.append(len(text))
                    packed.append(len(text) + 1)
                    packed.append(text)
            else:
                packed.append(value)
        key = tuple(lengths)
        pack = self._pack.get(key)
        if pack is None:
            if len(self._pack) >= self.LAYOUTS:
                self._pack.clear()
            pack = self._pack[key] = struct.Struct(self._format(key)).pack
        return pack(*packed)

    def _format(self, lengths: tuple[int, ...]) -> str:
        """The format in which a message with strings and arrays of these lengths is packed."""
        layout = _Layout()
        remaining = iter(lengths)
        layout.number("i", 4)
        layout.number("I", 4)
        layout.string(next(remaining))
        layout.number("Q", 8)
        for kind in self._kinds:
            if kind is _Kind.STRING:
                layout.string(next(remaining))
            elif kind is _Kind.STRINGS:
                layout.number("I", 4)
                for _ in range(next(remaining)):
                    layout.string(next(remaining))
            elif kind is _Kind.BYTES:
                layout.array(next(remaining), 1)
            elif kind is _Kind.FLOATS:
                layout.array(next(remaining), 8)
            else:
                layout.number(*_NUMBERS[kind])
        return layout.format


class _Layout:
    """A ``struct`` format under construction, with CDR's padding written out."""

    def __init__(self) -> None:
        self.format = f"<{len(_ENCAPSULATION)}s"
        self._position = 0

    def number(self, code: str, size: int) -> None:
        self._align(size)
        self._append(code, size)

    def string(self, length: int) -> None:
        """Length with the closing zero, the text, the zero (which ``struct`` fills in)."""
        self.number("I", 4)
        self._append(f"{length + 1}s", length + 1)

    def array(self, length: int, size: int) -> None:
        """Length, then the elements; where there is none nothing is aligned."""
        self.number("I", 4)
        if length:
            self._align(size)
        self._append(f"{length * size}s", length * size)

    def _align(self, size: int) -> None:
        padding = -self._position % size
        if padding:
            self._append(f"{padding}x", padding)

    def _append(self, code: str, size: int) -> None:
        self.format += code
        self._position += size
