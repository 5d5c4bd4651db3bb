"""Message types: msgspec Structs whose arrays travel as raw bytes.

A message is encoded as a msgpack array of its fields in order. ``Float64Array`` and ``Uint8Array`` fields are msgpack
``bin``: the elements as they lie in memory, little-endian. They arrive as read-only one-dimensional NumPy views.

An array field's annotation carries an ``ArrayKind``, and by that alone the kinds are told apart: which of NumPy's own
aliases are equal when a program runs differs from one NumPy to the next.
"""

from __future__ import annotations

from enum import Enum
from operator import methodcaller
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypeVar

import msgspec

# For comparisons; arrays are asked for their bytes, in C order, without NumPy being imported here.
_encode = msgspec.msgpack.Encoder(enc_hook=methodcaller("tobytes")).encode


class ArrayKind(Enum):
    """What the elements of an array field are, by NumPy's name of them; marks the field's annotation."""

    FLOAT64 = "float64"
    UINT8 = "uint8"


if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Float64Array: TypeAlias = Annotated[npt.NDArray[np.float64], ArrayKind.FLOAT64]
    Uint8Array: TypeAlias = Annotated[npt.NDArray[np.uint8], ArrayKind.UINT8]
else:  # the mark says it all, and NumPy is imported by whom arrays concern
    Float64Array = Annotated[Any, ArrayKind.FLOAT64]
    Uint8Array = Annotated[Any, ArrayKind.UINT8]


class Message(msgspec.Struct, array_like=True, forbid_unknown_fields=True, gc=False, eq=False):
    """Base of every message type. Its name, its fields' names and their types, in order, are its schema.

    Field types: ``int`` (64 bits), ``float``, ``bool``, ``str``, ``bytes``, ``Float64Array``, ``Uint8Array``,
    another Message, and ``list[...]`` or ``... | None`` of these. Two messages are equal when they are encoded alike.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return _encode(self) == _encode(other)

    def __ne__(self, other: object) -> bool:  # Struct has one of its own, which knows nothing of arrays
        return not self == other

    __hash__ = None  # type: ignore[assignment]  # messages are mutable


M = TypeVar("M", bound=Message)
