"""Encoding and decoding of message types, with checks that msgpack does not make."""

import typing
from collections.abc import Callable
from functools import cache, partial
from typing import Any, Generic

import msgspec

from bifrost.messages import Integer, M, Message
from bifrost.reflection import array_kind, field_types, list_type, optional_type, schema_of

_Check = Callable[[Any, str], None]
_LOWEST, _HIGHEST = -(2**63), 2**63 - 1


class Codec(Generic[M]):
    """Encodes and decodes one message type.

    Attributes:
        type: the class.
        name: of the class.
        schema: of the class.
        hash: of the schema on the wire, eight bytes.
        decode: bytes to a message; raises ``ValueError`` or ``msgspec.DecodeError`` unless they match it.
        encode_into: writes a message into a bytearray from an offset [B], and truncates the bytearray after it. Raises
            as ``encode``.
    """

    def __init__(self, message_type: type[M]) -> None:
        self.type = message_type
        self.name = message_type.__name__
        self.schema = schema_of(message_type)
        self.hash = self.schema.digest()
        _put_on_wire(message_type)
        self._encoder, decoder = _coders(message_type, self.schema.has_arrays)
        self.decode: Callable[[bytes | memoryview], M] = decoder.decode
        self._check = _message_check(message_type)
        self.encode_into = _encode_into(self._encoder, self._check, self.name)

    def encode(self, message: M) -> bytes:
        """The message as bytes. Raises TypeError: a field has a value of another type; names the field."""
        if self._check is not None:
            self._check(message, self.name)
        return self._encoder.encode(message)


def _coders(message_type: type[M], arrays: bool) -> tuple[msgspec.msgpack.Encoder, msgspec.msgpack.Decoder[M]]:
    if not arrays:
        return msgspec.msgpack.Encoder(), msgspec.msgpack.Decoder(message_type)
    from bifrost.arrays import ENCODER, decoder

    return ENCODER, decoder(message_type)


def _encode_into(
    encoder: msgspec.msgpack.Encoder, check: _Check | None, name: str
) -> Callable[[Any, bytearray, int], None]:
    encode = encoder.encode_into
    if check is None:
        return encode

    def checked(message: Any, buffer: bytearray, offset: int) -> None:
        check(message, name)
        encode(message, buffer, offset)

    return checked


@cache
def _cached(message_type: type[Message]) -> Codec[Any]:
    return Codec(message_type)


def codec(message_type: type[M]) -> Codec[M]:
    """The codec of a message type; cached."""
    return typing.cast("Codec[M]", _cached(message_type))


def _put_on_wire(message_type: type[Message]) -> None:
    """Set the fields' annotations for the decoder: integers of 64 signed bits, arrays of ``WIRE_TYPES``."""
    for field, annotation in field_types(message_type).items():
        message_type.__annotations__[field] = _on_wire(annotation)


def _on_wire(annotation: Any) -> Any:
    if annotation is int:
        return Integer
    if (kind := array_kind(annotation)) is not None:
        from bifrost.arrays import WIRE_TYPES

        return WIRE_TYPES[kind]
    if isinstance(annotation, type) and issubclass(annotation, Message):
        _put_on_wire(annotation)
    if (inner := list_type(annotation)) is not None:
        return list[_on_wire(inner)]  # type: ignore[misc]
    if (inner := optional_type(annotation)) is not None:
        return _on_wire(inner) | None
    return annotation


# On the wire an array is bytes: another element type would be misread, not rejected. Therefore the sender checks.
# A check is a function of the value and its name, made once for each type; None if there is nothing to check.


def _message_check(message_type: type[Message]) -> _Check | None:
    checks: list[tuple[str, _Check]] = []
    arrays: list[tuple[str, type[Any], object, _Check]] = []  # field, class, dtype
    integers: list[str] = []
    for field, annotation in field_types(message_type).items():
        check = _field_check(annotation)
        if check and (kind := array_kind(annotation)) is not None:
            from bifrost.arrays import DTYPES, ndarray

            arrays.append((field, ndarray, DTYPES[kind], check))
        elif annotation is int:
            integers.append(field)
        elif check:
            checks.append((field, check))
    if not arrays and not integers and not checks:
        return None

    def check_message(message: Any, name: str) -> None:
        for field, array, dtype, complain in arrays:
            value = getattr(message, field)
            # Three comparisons in the common case: this runs for every message of a control loop.
            if type(value) is not array or value.dtype is not dtype or value.ndim != 1:
                complain(value, f"{name}.{field}")
        for field in integers:
            value = getattr(message, field)
            if type(value) is not int or not _LOWEST <= value <= _HIGHEST:
                _check_integer(value, f"{name}.{field}")
        for field, check in checks:
            check(getattr(message, field), f"{name}.{field}")

    return check_message


def _field_check(annotation: Any) -> _Check | None:
    if isinstance(annotation, type) and issubclass(annotation, Message):
        return _message_check(annotation)
    if annotation is int:
        return _check_integer
    if (kind := array_kind(annotation)) is not None:
        from bifrost.arrays import array_check

        return array_check(kind)
    for inner, check_inner in ((list_type(annotation), _check_list), (optional_type(annotation), _check_optional)):
        if inner is not None and (check := _field_check(inner)) is not None:
            return partial(check_inner, check)
    return None


def _check_integer(value: Any, name: str) -> None:
    if not isinstance(value, int) or not _LOWEST <= value <= _HIGHEST:
        raise TypeError(f"{name}: expected an integer of 64 bits, got {value!r}")


def _check_list(check: _Check, values: Any, name: str) -> None:
    for index, value in enumerate(values):
        check(value, f"{name}[{index}]")


def _check_optional(check: _Check, value: Any, name: str) -> None:
    if value is not None:
        check(value, name)
