"""Message types: msgspec Structs whose arrays travel as raw bytes.

A message is encoded as a msgpack array of its fields in order. ``Float64Array`` and ``Uint8Array`` fields are msgpack
``bin``: the elements as they lie in memory, little-endian. They arrive as read-only one-dimensional NumPy views.

An array field's annotation carries an ``ArrayKind``, and by that alone the kinds are told apart: which of NumPy's own
aliases are equal when a program runs differs from one NumPy to the next.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Annotated, Any, TypeAlias, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt


class ArrayKind(Enum):
    """What the elements of an array field are; marks the field's annotation."""

    FLOAT64 = np.dtype(np.float64)
    UINT8 = np.dtype(np.uint8)


Float64Array: TypeAlias = Annotated[npt.NDArray[np.float64], ArrayKind.FLOAT64]
Uint8Array: TypeAlias = Annotated[npt.NDArray[np.uint8], ArrayKind.UINT8]


class Message(msgspec.Struct, array_like=True, forbid_unknown_fields=True, gc=False, eq=False):
    """Base of every message type. Its name, its fields' names and their types, in order, are its schema.

    Field types: ``int`` (64 bits), ``float``, ``bool``, ``str``, ``bytes``, ``Float64Array``, ``Uint8Array``,
    another Message, and ``list[...]`` or ``... | None`` of these. Two messages are equal when they are encoded alike.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return ENCODER.encode(self) == ENCODER.encode(other)

    def __ne__(self, other: object) -> bool:  # Struct has one of its own, which knows nothing of arrays
        return not self == other

    __hash__ = None  # type: ignore[assignment]  # messages are mutable


M = TypeVar("M", bound=Message)

# What msgspec does not know is asked for its bytes, in C order, and raises TypeError if it is no array.
ENCODER = msgspec.msgpack.Encoder(enc_hook=np.ndarray.tobytes)


# An array field as its decoder is shown it: msgspec drops markers, but hands on a type's arguments.
WIRE_TYPES: dict[ArrayKind, Any] = {kind: np.ndarray[Any, kind.value] for kind in ArrayKind}  # type: ignore[name-defined]


def _array(wire_type: Any, value: Any, _view: Callable[..., Any] = np.frombuffer) -> Any:
    return _view(value, wire_type.__args__[1])  # raises TypeError on all but bytes


def decoder(message_type: type[M]) -> msgspec.msgpack.Decoder[M]:
    """A decoder that accepts what is exactly of this type, and raises ``ValueError`` or its kin on all else.

    Args:
        message_type: what it decodes; its array fields are of ``WIRE_TYPES``.
    """
    return msgspec.msgpack.Decoder(message_type, dec_hook=_array)
