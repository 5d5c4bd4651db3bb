"""Array fields, in NumPy. Imported with the first message type that has one.

NumPy takes longer to import than the rest of Bifrost; programs without arrays do not wait for it.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import msgspec
import numpy as np

from bifrost.messages import ArrayKind

S = TypeVar("S", bound=msgspec.Struct)

ndarray = np.ndarray  # the class of every array

DTYPES: dict[ArrayKind, np.dtype[Any]] = {kind: np.dtype(kind.value) for kind in ArrayKind}

# Encodes arrays as bytes in C order; raises TypeError for other types that msgspec does not support.
ENCODER = msgspec.msgpack.Encoder(enc_hook=np.ndarray.tobytes)

# Array fields for the decoder: msgspec drops annotations, but passes on a type's arguments.
WIRE_TYPES: dict[ArrayKind, Any] = {kind: np.ndarray[Any, dtype] for kind, dtype in DTYPES.items()}  # type: ignore[valid-type]


def _array(wire_type: Any, value: Any, _view: Callable[..., Any] = np.frombuffer) -> Any:
    return _view(value, wire_type.__args__[1])  # raises TypeError unless the value is bytes


def decoder(message_type: type[S]) -> msgspec.msgpack.Decoder[S]:
    """A decoder that raises ``ValueError`` or ``msgspec.DecodeError`` unless a message is exactly of this type."""
    return msgspec.msgpack.Decoder(message_type, dec_hook=_array)


def array_check(kind: ArrayKind) -> Callable[[Any, str], None]:
    """A function that raises TypeError, with the name, unless a value is an array of this kind."""
    dtype = DTYPES[kind]

    def check_array(value: Any, name: str) -> None:
        if isinstance(value, np.ndarray) and value.dtype == dtype and value.ndim == 1:
            return
        what = f"{value.dtype} of shape {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
        raise TypeError(f"{name}: expected a one-dimensional {dtype.name} array, got {what}")

    return check_array
