"""Message types: msgspec Structs whose arrays travel as raw bytes.

A message is encoded as a msgpack array of its fields in order. ``Float64Array`` and ``Uint8Array`` fields are msgpack
``bin``: the elements as they lie in memory, little-endian. They arrive as read-only one-dimensional NumPy views.

An array field's annotation carries an ``ArrayKind``, and by that alone the kinds are told apart: which of NumPy's own
aliases are equal when a program runs differs from one NumPy to the next.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypeVar

import msgspec

from bifrost.array_kind import ArrayKind

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
        from bifrost.arrays import ENCODER

        return ENCODER.encode(self) == ENCODER.encode(other)

    def __ne__(self, other: object) -> bool:  # Struct has one of its own, which knows nothing of arrays
        return not self == other

    __hash__ = None  # type: ignore[assignment]  # messages are mutable


M = TypeVar("M", bound=Message)
