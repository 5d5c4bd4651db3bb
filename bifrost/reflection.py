"""Reflection for tools: fields and schema of a message type, classes made from schemas, conversion to JSON types."""

import math
import types
import typing
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

import msgspec

from bifrost.errors import SchemaError
from bifrost.messages import ArrayKind, Float64Array, Integer, M, Message, Schema, Uint8Array

_PLAIN: dict[str, Any] = {
    "int": int,
    "float": float,
    "bool": bool,
    "str": str,
    "bytes": bytes,
    "float64[]": Float64Array,
    "uint8[]": Uint8Array,
}


def schema_of(message_type: type[Message]) -> Schema:
    """The schema of a message type. Raises TypeError: a field has an unsupported type; names the field."""
    described: dict[str, list[list[str]]] = {}
    _describe(message_type, described, {})
    return Schema(message_type.__name__, described)


@cache
def field_types(message_type: type[Message]) -> Mapping[str, Any]:
    """The annotations of a message type's fields as declared, unchanged by codecs."""
    types = typing.get_type_hints(message_type, include_extras=True)
    for base in message_type.__bases__:
        if issubclass(base, Message):
            types |= {
                name: kind for name, kind in field_types(base).items() if name not in message_type.__annotations__
            }
    return {name: types[name] for name in message_type.__struct_fields__}


def array_kind(annotation: Any) -> ArrayKind | None:
    """The mark of an array field; None for every other annotation."""
    if typing.get_origin(annotation) is not typing.Annotated:
        return None
    return next((mark for mark in annotation.__metadata__ if isinstance(mark, ArrayKind)), None)


def optional_type(annotation: Any) -> Any:
    """``T`` of ``T | None``; None for every other annotation."""
    arguments = typing.get_args(annotation)
    if typing.get_origin(annotation) not in (typing.Union, types.UnionType) or len(arguments) != 2:
        return None
    if type(None) not in arguments:
        return None
    return arguments[0] if arguments[1] is type(None) else arguments[1]


def list_type(annotation: Any) -> Any:
    """``T`` of ``list[T]``; None for every other annotation."""
    return typing.get_args(annotation)[0] if typing.get_origin(annotation) is list else None


def _describe(
    message_type: type[Message], described: dict[str, list[list[str]]], classes: dict[str, type[Message]]
) -> None:
    name = message_type.__name__
    if classes.setdefault(name, message_type) is not message_type:
        raise TypeError(f"{name}: two types of one name in one message")
    if name in described:
        return
    fields = described[name] = []
    for field, annotation in field_types(message_type).items():
        fields.append([field, _describe_type(annotation, described, classes, f"{name}.{field}")])


def _describe_type(
    annotation: Any, described: dict[str, list[list[str]]], classes: dict[str, type[Message]], where: str
) -> str:
    if (kind := array_kind(annotation)) is not None:
        return f"{kind.value}[]"
    for text, plain in _PLAIN.items():
        if annotation is plain:
            return text
    if (inner := list_type(annotation)) is not None:
        return f"list<{_describe_type(inner, described, classes, where)}>"
    if (inner := optional_type(annotation)) is not None:
        return f"{_describe_type(inner, described, classes, where)}?"
    if isinstance(annotation, type) and issubclass(annotation, Message):
        _describe(annotation, described, classes)
        return annotation.__name__
    raise TypeError(f"{where}: {annotation!r} is not supported in a message; see bifrost.Message")


def type_from_schema(schema: Schema) -> type[Message]:
    """A message class with the encoding of a schema. Raises SchemaError: the schema is not well formed."""
    made: dict[str, type[Message]] = {}
    try:
        _make(schema, schema.name, made, ())
    except (TypeError, ValueError, RecursionError) as error:
        raise SchemaError(f"schema of {schema.name}: {error}") from None
    return made[schema.name]


def _make(schema: Schema, name: str, made: dict[str, type[Message]], above: tuple[str, ...]) -> None:
    if name in above:
        raise SchemaError(f"schema of {schema.name}: {name} contains itself")
    if name not in schema.types:
        raise SchemaError(f"schema of {schema.name}: no type {name!r}")
    fields = []
    for field, text in schema.types[name]:
        element = text.replace("list<", "").replace(">", "").replace("?", "")
        if element not in _PLAIN and element not in made:
            _make(schema, element, made, (*above, name))
        fields.append((field, _parse_type(text, made)))
    made[name] = msgspec.defstruct(  # type: ignore[assignment]
        name, fields, bases=(Message,), array_like=True, forbid_unknown_fields=True, gc=False, eq=False
    )


def _parse_type(text: str, made: Mapping[str, type[Message]]) -> Any:
    if text.endswith("?"):
        return _parse_type(text[:-1], made) | None
    if text.startswith("list<") and text.endswith(">"):
        return list[_parse_type(text[5:-1], made)]  # type: ignore[misc]
    if text in _PLAIN:
        return _PLAIN[text]
    if text in made:
        return made[text]
    raise SchemaError(f"no type {text!r}")


def to_builtins(value: Any) -> Any:
    """A message as dict: arrays as lists, bytes as hexadecimal text, non-finite numbers as None."""
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


def lines(value: Mapping[str, Any], indent: str = "") -> Iterator[str]:
    """Result of ``to_builtins`` as YAML-like lines: flat lists in one line, six digits a number."""
    for name, field in value.items():
        if isinstance(field, dict):
            yield f"{indent}{name}:"
            yield from lines(field, indent + "  ")
        elif isinstance(field, list) and any(isinstance(element, dict) for element in field):
            yield f"{indent}{name}:"
            for index, element in enumerate(field):
                yield f"{indent}  [{index}]"
                yield from lines(element, indent + "    ")
        elif isinstance(field, list):
            yield f"{indent}{name}: [{', '.join(number(element) for element in field)}]"
        else:
            yield f"{indent}{name}: {number(field)}"


def number(value: Any) -> str:
    """A value with six digits; None is NaN."""
    if value is None:
        return "nan"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def from_json(message_type: type[M], text: str) -> M:
    """A message from JSON, the inverse of ``to_builtins``; null numbers become NaN.

    Raises SchemaError: invalid JSON, or a field is missing, unknown or of another type.
    """
    try:
        return typing.cast("M", _from_json(message_type, msgspec.json.decode(text, type=_json_type(message_type))))
    except (ValueError, OverflowError, RecursionError) as error:
        fields = ", ".join(message_type.__struct_fields__)
        raise SchemaError(f"{message_type.__name__}: {error}; expected an object of {fields}") from None


def _json_type(annotation: Any) -> Any:
    """The type of a field in JSON."""
    if (kind := array_kind(annotation)) is not None:
        return list[float | None] if kind is ArrayKind.FLOAT64 else list[int]
    if (inner := list_type(annotation)) is not None:
        return list[_json_type(inner)]  # type: ignore[misc]
    if (inner := optional_type(annotation)) is not None:
        return _json_type(inner) | None
    if isinstance(annotation, type) and issubclass(annotation, Message):
        fields = [(name, _json_type(field)) for name, field in field_types(annotation).items()]
        return msgspec.defstruct(annotation.__name__, fields, forbid_unknown_fields=True)
    return {int: Integer, float: float | None, bytes: str}.get(annotation, annotation)


def _from_json(annotation: Any, value: Any) -> Any:
    if (kind := array_kind(annotation)) is not None:
        import numpy as np  # slow import, needed for arrays only

        return np.array([math.nan if element is None else element for element in value], kind.value)
    if (inner := list_type(annotation)) is not None:
        return [_from_json(inner, element) for element in value]
    if (inner := optional_type(annotation)) is not None:
        return None if value is None else _from_json(inner, value)
    if isinstance(value, msgspec.Struct):
        return annotation(*(_from_json(field, getattr(value, name)) for name, field in field_types(annotation).items()))
    if annotation is bytes:
        return bytes.fromhex(value)
    return math.nan if value is None else value
