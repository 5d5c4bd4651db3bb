"""Messages as what JSON knows, and back: for tools and the command line."""

from __future__ import annotations

import math
import typing
from typing import Any

from bifrost.errors import SchemaError
from bifrost.messages import ArrayKind, M, Message
from bifrost.reflection import array_kind, field_types, list_type, optional_type


def to_builtins(value: Any) -> Any:
    """A message as dict: arrays as lists, bytes as hexadecimal text, numbers that are not finite as None."""
    if isinstance(value, Message):
        return {name: to_builtins(getattr(value, name)) for name in value.__struct_fields__}
    if isinstance(value, list):
        return [to_builtins(element) for element in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, bytes):
        return value.hex()
    if value is None or isinstance(value, (int, str)):
        return value
    return to_builtins(value.tolist())


def from_builtins(message_type: type[M], value: object) -> M:
    """A message from a dict; the inverse of ``to_builtins``, None becoming NaN.

    Raises:
        SchemaError: a field is missing, unknown or of another type; names it.
    """
    return typing.cast("M", _message(message_type, value, message_type.__name__))


def _message(message_type: type[Message], value: object, where: str) -> Message:
    fields = message_type.__struct_fields__
    if not isinstance(value, dict):
        raise SchemaError(f"{where}: expected an object with the fields {', '.join(fields)}")
    for name in value:
        if name not in fields:
            raise SchemaError(f"{where} has no field {name!r}; it has {', '.join(fields)}")
    for name in fields:
        if name not in value:
            raise SchemaError(f"{where}.{name} is missing")
    types = field_types(message_type)
    return message_type(*(_field(types[name], value[name], f"{where}.{name}") for name in fields))


def _field(annotation: Any, value: Any, where: str) -> Any:
    if (kind := array_kind(annotation)) is not None:
        return _array(value, kind, where)
    if (inner := list_type(annotation)) is not None:
        if not isinstance(value, list):
            raise SchemaError(f"{where}: expected a list, got {value!r}")
        return [_field(inner, element, f"{where}[{index}]") for index, element in enumerate(value)]
    if (inner := optional_type(annotation)) is not None:
        return None if value is None else _field(inner, value, where)
    if issubclass(annotation, Message):
        return _message(annotation, value, where)
    return _scalar(annotation, value, where)


def _array(value: Any, kind: ArrayKind, where: str) -> Any:
    import numpy as np  # takes long, and not every message has arrays

    try:
        array = np.array([math.nan if element is None else element for element in value], kind.value)
    except (TypeError, ValueError, OverflowError):
        array = np.zeros((0, 0))
    if array.ndim != 1:
        raise SchemaError(f"{where}: expected a list of {kind.value} numbers, got {value!r}")
    return array


def _scalar(annotation: Any, value: Any, where: str) -> Any:
    if annotation is float:
        if value is None:
            return math.nan
        if isinstance(value, int) and not isinstance(value, bool):
            return float(value)
    if annotation is bytes and isinstance(value, str):
        try:
            return bytes.fromhex(value)
        except ValueError:
            raise SchemaError(f"{where}: expected hexadecimal text, got {value!r}") from None
    if type(value) is not annotation:
        raise SchemaError(f"{where}: expected {annotation.__name__}, got {value!r}")
    if annotation is int and not -(2**63) <= value < 2**63:
        raise SchemaError(f"{where}: expected an integer of 64 bits, got {value!r}")
    return value
