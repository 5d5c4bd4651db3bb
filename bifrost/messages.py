"""Message types: msgspec Structs whose arrays travel as raw bytes, and the schema by which two nodes know that they agree.

A message is encoded as a msgpack array of its fields in order. ``Float64Array`` and ``Uint8Array`` fields are msgpack
``bin``: the elements as they lie in memory, little-endian. They arrive as read-only one-dimensional NumPy views.
"""

from __future__ import annotations

import hashlib
import json
import math
import types
import typing
from collections.abc import Callable, Mapping
from enum import Enum
from functools import cache
from operator import attrgetter
from typing import Any, Generic, TypeAlias, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt

from bifrost.errors import SchemaError

Float64Array: TypeAlias = npt.NDArray[np.float64]
Uint8Array: TypeAlias = npt.NDArray[np.uint8]

_FLOAT64 = np.dtype(np.float64)
_UINT8 = np.dtype(np.uint8)
_ARRAYS: dict[str, tuple[Any, np.dtype[Any]]] = {
    "float64[]": (Float64Array, _FLOAT64),
    "uint8[]": (Uint8Array, _UINT8),
}
_SCALARS: dict[Any, str] = {int: "int", float: "float", bool: "bool", str: "str", bytes: "bytes"}


class Message(msgspec.Struct, array_like=True, forbid_unknown_fields=True, gc=False, eq=False):
    """Base of every message type. Its name, its fields' names and their types, in order, are its schema.

    Field types: ``int`` (64 bits), ``float``, ``bool``, ``str``, ``bytes``, ``Float64Array``, ``Uint8Array``,
    another Message, and ``list[...]`` or ``... | None`` of these. Two messages are equal when they are encoded alike.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return codec(type(self)).encode(self) == codec(type(self)).encode(other)

    __hash__ = None  # type: ignore[assignment]  # messages are mutable


M = TypeVar("M", bound=Message)


def _describe_type(annotation: Any, nested: dict[str, list[list[str]]], where: str) -> str:
    if annotation in _SCALARS:
        return _SCALARS[annotation]
    for text, (array, _) in _ARRAYS.items():
        if annotation == array:
            return text
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is list:
        return f"list<{_describe_type(arguments[0], nested, where)}>"
    if origin in (typing.Union, types.UnionType) and len(arguments) == 2 and type(None) in arguments:
        inner = arguments[0] if arguments[1] is type(None) else arguments[1]
        return f"{_describe_type(inner, nested, where)}?"
    if isinstance(annotation, type) and issubclass(annotation, Message):
        _describe_fields(annotation, nested)
        return annotation.__name__
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        raise TypeError(f"{where}: enumerations travel as int or str")
    raise TypeError(f"{where}: {annotation!r} is no type of a message field")


def _describe_fields(cls: type[Message], nested: dict[str, list[list[str]]]) -> None:
    if cls.__name__ in nested:
        return
    fields: list[list[str]] = []
    nested[cls.__name__] = fields
    hints = typing.get_type_hints(cls)
    for name in cls.__struct_fields__:
        fields.append([name, _describe_type(hints[name], nested, f"{cls.__name__}.{name}")])


class Schema(msgspec.Struct, frozen=True):
    """What a message type looks like, for peers and tools that do not have its class.

    Attributes:
        name: of the class.
        types: class name to list of [field, type], of the class itself and of every message it contains. Types are
            ``int``, ``float``, ``bool``, ``str``, ``bytes``, ``float64[]``, ``uint8[]``, ``list<T>``, ``T?`` or a
            class name.
    """

    name: str
    types: dict[str, list[list[str]]]

    def digest(self) -> bytes:
        """Eight bytes that differ when anything above does: BLAKE2b of the schema as canonical JSON."""
        text = json.dumps([self.name, self.types], sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()
        return hashlib.blake2b(text, digest_size=8).digest()


class Codec(Generic[M]):
    """Encodes and decodes one message type.

    Attributes:
        schema: what the type looks like.
        hash: eight bytes that stand for it on the wire.
        name: of the type.
    """

    def __init__(self, cls: type[M]) -> None:
        nested: dict[str, list[list[str]]] = {}
        _describe_fields(cls, nested)
        self.type = cls
        self.schema = Schema(cls.__name__, nested)
        self.name = cls.__name__
        self.hash = self.schema.digest()
        self._encoder = msgspec.msgpack.Encoder(enc_hook=_to_bytes)
        self._decoder = msgspec.msgpack.Decoder(cls, dec_hook=_from_bytes)
        self.decode: Callable[[bytes | memoryview], M] = self._decoder.decode
        self._check = _array_check(cls)

    def encode(self, message: M) -> bytes:
        """The message as bytes.

        Raises:
            TypeError: a field does not hold what its type says; names it.
        """
        check = self._check
        if check is not None:
            check(message)
        return self._encoder.encode(message)


@cache
def _cached_codec(cls: type[Message]) -> Codec[Any]:
    return Codec(cls)


def codec(cls: type[M]) -> Codec[M]:
    """The codec of a message type; made once a type."""
    return typing.cast("Codec[M]", _cached_codec(cls))


def _to_bytes(value: object) -> bytes:
    if isinstance(value, np.ndarray):
        return value.tobytes()
    raise TypeError(f"{type(value).__name__} cannot be a message field")


def _from_bytes(annotation: Any, value: object) -> npt.NDArray[Any]:
    if type(value) is not bytes:
        raise ValueError("expected an array as bytes")
    return np.frombuffer(value, _FLOAT64 if annotation == Float64Array else _UINT8)


def _array_check(cls: type[Message]) -> Callable[[Message], None] | None:
    """A function that raises unless every array field holds a one-dimensional array of its own type.

    On the wire an array is bytes, so that the wrong one would be misread rather than refused.
    """
    hints = typing.get_type_hints(cls)
    names: list[str] = []
    dtypes: list[np.dtype[Any]] = []
    nested: list[tuple[str, Callable[[Message], None]]] = []
    for name in cls.__struct_fields__:
        annotation = hints[name]
        for array, dtype in _ARRAYS.values():
            if annotation == array:
                names.append(name)
                dtypes.append(dtype)
                break
        else:
            inner = _nested_check(annotation)
            if inner is not None:
                nested.append((name, inner))
    if not names and not nested:
        return None
    values: Callable[[Message], Any] = (
        attrgetter(*names) if len(names) > 1 else lambda message: tuple(getattr(message, n) for n in names)
    )

    def check(message: Message) -> None:
        index = 0
        for array in values(message):
            try:
                wrong = array.dtype is not dtypes[index] and array.dtype != dtypes[index] or array.ndim != 1
            except AttributeError:
                wrong = True
            if wrong:
                raise TypeError(
                    f"{cls.__name__}.{names[index]}: expected a one-dimensional {dtypes[index]} array, "
                    f"got {_what(array)}"
                )
            index += 1
        for name, inner in nested:
            inner(getattr(message, name))

    return check


def _nested_check(annotation: Any) -> Callable[[Any], None] | None:
    """The check of a field that may hold arrays deeper down; None when it cannot."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if isinstance(annotation, type) and issubclass(annotation, Message):
        return typing.cast("Callable[[Any], None] | None", _array_check(annotation))
    for text, (array, dtype) in _ARRAYS.items():
        if annotation == array:

            def check_array(value: Any) -> None:
                if not isinstance(value, np.ndarray) or value.dtype != dtype or value.ndim != 1:
                    raise TypeError(f"expected a one-dimensional {text} array, got {_what(value)}")

            return check_array
    if origin is list:
        inner = _nested_check(arguments[0])
        if inner is not None:
            element_check = inner

            def check_list(values: Any) -> None:
                for value in values:
                    element_check(value)

            return check_list
    if origin in (typing.Union, types.UnionType):
        for argument in arguments:
            inner = _nested_check(argument)
            if inner is not None:
                some_check = inner

                def check_optional(value: Any) -> None:
                    if value is not None:
                        some_check(value)

                return check_optional
    return None


def _what(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype} of shape {value.shape}"
    return type(value).__name__


def _parse_type(text: str, known: Mapping[str, Any]) -> Any:
    if text.endswith("?"):
        return _parse_type(text[:-1], known) | None
    if text.startswith("list<") and text.endswith(">"):
        return list[_parse_type(text[5:-1], known)]  # type: ignore[misc]
    if text in _ARRAYS:
        return _ARRAYS[text][0]
    for scalar, name in _SCALARS.items():
        if text == name:
            return scalar
    if text in known:
        return known[text]
    raise SchemaError(f"schema names an unknown type {text!r}")


def type_from_schema(schema: Schema) -> type[Message]:
    """A message class made from a schema: decodes like the sender's own.

    Raises:
        SchemaError: the schema is not well formed.
    """
    made: dict[str, Any] = {}

    def make(name: str, above: tuple[str, ...]) -> None:
        if name in made:
            return
        if name in above or name not in schema.types:
            raise SchemaError(f"schema of {schema.name}: {name} is missing or contains itself")
        fields = []
        for field, text in schema.types[name]:
            core = text.replace("list<", "").replace(">", "").replace("?", "")
            if core in schema.types:
                make(core, (*above, name))
            fields.append((field, _parse_type(text, made)))
        made[name] = msgspec.defstruct(
            name, fields, bases=(Message,), array_like=True, forbid_unknown_fields=True, gc=False, eq=False
        )

    try:
        make(schema.name, ())
    except SchemaError:
        raise
    except Exception as error:
        raise SchemaError(f"schema of {schema.name}: {error}") from None
    return typing.cast("type[Message]", made[schema.name])


def to_builtins(value: Any) -> Any:
    """A message as what JSON knows: arrays as lists, bytes as hexadecimal text, not-finite numbers as None."""
    if isinstance(value, Message):
        return {name: to_builtins(getattr(value, name)) for name in value.__struct_fields__}
    if isinstance(value, np.ndarray):
        return [to_builtins(element) for element in value.tolist()]
    if isinstance(value, list):
        return [to_builtins(element) for element in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, bytes):
        return value.hex()
    return value


def from_builtins(cls: type[M], value: object) -> M:
    """A message from what JSON knows; the inverse of ``to_builtins`` for finite numbers.

    Raises:
        SchemaError: a field is missing, unknown or of another type; names it.
    """
    hints = typing.get_type_hints(cls)
    if not isinstance(value, dict):
        raise SchemaError(f"{cls.__name__}: expected an object with {', '.join(cls.__struct_fields__)}")
    for name in value:
        if name not in cls.__struct_fields__:
            raise SchemaError(f"{cls.__name__} has no field {name!r}; it has {', '.join(cls.__struct_fields__)}")
    for name in cls.__struct_fields__:
        if name not in value:
            raise SchemaError(f"{cls.__name__}.{name} is missing")
    return cls(
        **{
            name: _field_from_builtins(hints[name], value[name], f"{cls.__name__}.{name}")
            for name in cls.__struct_fields__
        }
    )


def _field_from_builtins(annotation: Any, value: Any, where: str) -> Any:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    for array, dtype in _ARRAYS.values():
        if annotation == array:
            try:
                made = np.array([math.nan if element is None else element for element in value], dtype)
            except (TypeError, ValueError, OverflowError):
                raise SchemaError(f"{where}: expected a list of numbers, got {value!r}") from None
            if made.ndim != 1:
                raise SchemaError(f"{where}: expected a flat list of numbers, got {value!r}")
            return made
    if origin is list:
        if not isinstance(value, list):
            raise SchemaError(f"{where}: expected a list, got {value!r}")
        return [_field_from_builtins(arguments[0], each, f"{where}[{i}]") for i, each in enumerate(value)]
    if origin in (typing.Union, types.UnionType):
        if value is None:
            return None
        inner = arguments[0] if arguments[1] is type(None) else arguments[1]
        return _field_from_builtins(inner, value, where)
    if isinstance(annotation, type) and issubclass(annotation, Message):
        return from_builtins(annotation, value)
    if annotation is float and value is None:
        return math.nan
    if annotation is bytes and isinstance(value, str):
        try:
            return bytes.fromhex(value)
        except ValueError:
            raise SchemaError(f"{where}: expected hexadecimal text, got {value!r}") from None
    if annotation is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, annotation) or (annotation is int and isinstance(value, bool)):
        raise SchemaError(f"{where}: expected {annotation.__name__}, got {value!r}")
    return value
