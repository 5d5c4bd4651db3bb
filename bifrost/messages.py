"""Message types: msgspec Structs whose arrays travel as raw bytes.

A message is encoded as a msgpack array of its fields in order. ``Float64Array`` and ``Uint8Array`` fields are msgpack
``bin``: the elements as they lie in memory, little-endian. They arrive as read-only one-dimensional NumPy views.
"""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt

Float64Array: TypeAlias = npt.NDArray[np.float64]
Uint8Array: TypeAlias = npt.NDArray[np.uint8]

FLOAT64 = np.dtype(np.float64)
UINT8 = np.dtype(np.uint8)
_view = np.frombuffer


def _reals(_annotation: Any, value: Any) -> Any:
    return _view(value)  # float64 by itself; raises TypeError on all but bytes


def _octets(_annotation: Any, value: Any) -> Any:
    return _view(value, UINT8)


def _either(annotation: Any, value: Any) -> Any:
    return _view(value, FLOAT64 if annotation == Float64Array else UINT8)


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


def decoder(message_type: type[M], reals: bool, octets: bool) -> msgspec.msgpack.Decoder[M]:
    """A decoder that accepts what is exactly of this type, and raises ``ValueError`` or its kin on all else.

    Args:
        message_type: what it decodes.
        reals: whether there is a ``Float64Array`` anywhere in it.
        octets: whether there is a ``Uint8Array``: telling the two apart takes a third of the time that an array takes.
    """
    return msgspec.msgpack.Decoder(
        message_type, dec_hook=_either if reals and octets else _octets if octets else _reals
    )
