"""Array fields, which are NumPy's: this module is imported with the first message type that has one.

NumPy takes longer to import than all the rest of Bifrost, and who hears no arrays need not wait for it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import msgspec
import numpy as np

from bifrost.messages import ArrayKind

S = TypeVar("S", bound=msgspec.Struct)

ndarray = np.ndarray  # the class of every array

DTYPES: dict[ArrayKind, np.dtype[Any]] = {kind: np.dtype(kind.value) for kind in ArrayKind}

# What msgspec does not know is asked for its bytes, in C order, and raises TypeError if it is no array.
ENCODER = msgspec.msgpack.Encoder(enc_hook=np.ndarray.tobytes)

# An array field as its decoder is shown it: msgspec drops markers, but hands on a type's arguments.
WIRE_TYPES: dict[ArrayKind, Any] = {kind: np.ndarray[Any, dtype] for kind, dtype in DTYPES.items()}  # type: ignore[valid-type]


def _array(wire_type: Any, value: Any, _view: Callable[..., Any] = np.frombuffer) -> Any:
    return _view(value, wire_type.__args__[1])  # raises TypeError on all but bytes


def decoder(message_type: type[S]) -> msgspec.msgpack.Decoder[S]:
    """A decoder that accepts what is exactly of this type, and raises ``ValueError`` or its kin on all else.

    Args:
        message_type: what it decodes; its array fields are of ``WIRE_TYPES``.
    """
    return msgspec.msgpack.Decoder(message_type, dec_hook=_array)


def array_check(kind: ArrayKind) -> Callable[[Any, str], None]:
    """What raises TypeError on a value that is no array of this kind, and names it."""
    dtype = DTYPES[kind]

    def check_array(value: Any, name: str) -> None:
        if isinstance(value, np.ndarray) and value.dtype == dtype and value.ndim == 1:
            return
        what = f"{value.dtype} of shape {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
        raise TypeError(f"{name}: expected a one-dimensional {dtype.name} array, got {what}")

    return check_array
