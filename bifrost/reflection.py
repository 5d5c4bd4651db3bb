"""Reflection: the fields of a message type, its schema, and a class made of a schema for tools that lack the type's."""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping
from functools import cache
from typing import Any

import msgspec

from bifrost.errors import SchemaError
from bifrost.messages import ArrayKind, Float64Array, Message, Uint8Array
from bifrost.schema import Schema

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
    """The schema of a message type.

    Raises:
        TypeError: a field is of a type that no message can have; names it.
    """
    described: dict[str, list[list[str]]] = {}
    _describe(message_type, described, {})
    return Schema(message_type.__name__, described)


@cache
def field_types(message_type: type[Message]) -> Mapping[str, Any]:
    """The annotations of a message type's fields, as they were declared, whatever codecs make of them."""
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
    raise TypeError(f"{where}: {annotation!r} is no type of a message field; see bifrost.Message")


def type_from_schema(schema: Schema) -> type[Message]:
    """A message class made from a schema; it encodes and decodes like the original.

    Raises:
        SchemaError: the schema is not well formed.
    """
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
