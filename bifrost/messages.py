"""Message types: msgspec Structs whose arrays travel as raw bytes.

A message is encoded as a msgpack array of its fields in order. ``Float64Array`` and ``Uint8Array`` fields are msgpack
``bin``: the elements as in memory, little-endian. They are received as read-only one-dimensional NumPy views.

An array field's annotation has an ``ArrayKind``, which alone identifies the kind: the equality of NumPy's own aliases
at run time depends on the version of NumPy.
"""

from __future__ import annotations

import hashlib
import json
from enum import Enum
from operator import methodcaller
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypeVar

import msgspec

# For comparisons; encodes arrays as bytes in C order without an import of NumPy.
_encode = msgspec.msgpack.Encoder(enc_hook=methodcaller("tobytes")).encode


class ArrayKind(Enum):
    """Element type of an array field, by NumPy's name; marks the field's annotation."""

    FLOAT64 = "float64"
    UINT8 = "uint8"


if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Float64Array: TypeAlias = Annotated[npt.NDArray[np.float64], ArrayKind.FLOAT64]
    Uint8Array: TypeAlias = Annotated[npt.NDArray[np.uint8], ArrayKind.UINT8]
else:  # the mark is sufficient, and avoids the import of NumPy
    Float64Array = Annotated[Any, ArrayKind.FLOAT64]
    Uint8Array = Annotated[Any, ArrayKind.UINT8]


class Message(msgspec.Struct, array_like=True, forbid_unknown_fields=True, gc=False, eq=False):
    """Base of all message types. Name, field names and field types, in order, are the schema.

    Field types: ``int`` (64 bits), ``float``, ``bool``, ``str``, ``bytes``, ``Float64Array``, ``Uint8Array``,
    another Message, and ``list[...]`` or ``... | None`` of these. Messages with equal encoding are equal.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return _encode(self) == _encode(other)

    def __ne__(self, other: object) -> bool:  # Struct's own does not support arrays
        return not self == other

    __hash__ = None  # type: ignore[assignment]  # messages are mutable


M = TypeVar("M", bound=Message)
Integer = Annotated[int, msgspec.Meta(ge=-(2**63), le=2**63 - 1)]  # msgpack also has unsigned ones


class Schema(msgspec.Struct, frozen=True):
    """Fields and types of a message.

    Attributes:
        name: of the class.
        types: list of [field, type] by class name, for the class and every message that it contains. A type is
            ``int``, ``float``, ``bool``, ``str``, ``bytes``, ``float64[]``, ``uint8[]``, ``list<T>``, ``T?`` (or
            none), or a class name.
    """

    name: str
    types: dict[str, list[list[str]]]

    @property
    def has_arrays(self) -> bool:
        """True if a field, or a field of a contained message, is an array or a list of arrays."""
        return any("[]" in kind for fields in self.types.values() for _, kind in fields)

    def digest(self) -> bytes:
        """Hash of eight bytes: BLAKE2b of the schema as canonical JSON."""
        content = [self.name, self.types]
        text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        return hashlib.blake2b(text.encode(), digest_size=8).digest()
