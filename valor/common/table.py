"""Tables: contents of files as data classes that msgspec checks; errors name key, value and expectation."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, dataclass_transform, get_args, get_origin

import msgspec

from valor.common.errors import SeveralFaultsError

Positive = Annotated[float, msgspec.Meta(gt=0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0)]

_LONGEST = 40  # characters of a value that an error repeats
_TYPES = re.compile(r"`([\w |]+)`")
_WORDS = {"object": "a mapping", "array": "a list", "null": "nothing"}
_BOUND = re.compile(r"[<>]=? [\d.e+-]+")
_MISSING = "expected, but missing"
_CHOICE = re.compile(r"Invalid (?:enum )?value (.*?)(?: - at .*)?")


@dataclass_transform(frozen_default=True, kw_only_default=True)
class _TableMeta(msgspec.StructMeta):
    """msgspec does not inherit ``kw_only``; subclasses repeat it where mypy needs it."""

    def __new__(cls, name: str, bases: tuple[type, ...], namespace: dict[str, Any], **options: Any) -> _TableMeta:
        return super().__new__(cls, name, bases, namespace, **({"kw_only": True} | options))


class Table(msgspec.Struct, metaclass=_TableMeta, frozen=True, forbid_unknown_fields=True):
    """A part of a file: unknown keys are errors, numbers are finite, values are immutable.

    ``__post_init__`` checks rules between values; it raises ``TableError`` with the path from the table.
    """


T = TypeVar("T", bound=Table)


class TableError(ValueError):
    """A value that its table rejects: its path, empty for the table, and ``what`` was found and is expected."""

    def __init__(self, path: Sequence[str], what: str) -> None:
        self.path = tuple(path)
        self.key = ".".join(self.path)  # joints.l_knee_pitch.velocity
        self.what = what
        super().__init__(f"{self.key or '(whole file)'}: {what}")


def checked(kind: type[T], content: object) -> T:
    """Convert plain values to a table. Raises TableError about the first wrong key."""
    for error in _infinite(content):
        raise error
    try:
        return msgspec.convert(content, kind, dec_hook=_other_type)
    except msgspec.ValidationError:
        raise faults(kind, content)[0] from None


def require_order(table: Table, lower: str, upper: str) -> None:
    """Raise ``TableError`` unless one number of a table is less than another."""
    one, other = getattr(table, lower), getattr(table, upper)
    if one >= other:
        raise TableError((lower,), f"got {one}; expected less than {upper}, {other}")


def plain(table: Table) -> dict[str, Any]:
    """Plain values of a table, the inverse of ``checked``."""
    content: dict[str, Any] = msgspec.to_builtins(table, enc_hook=str)
    return content


def read(kind: type[T], file: Path, violations: Callable[[T], Iterable[TableError]] = lambda _: ()) -> T:
    """Read a table from a YAML file. Raises ConfigurationError: a line for each fault, with file, line and key.

    ``violations``: of a valid table; the first one is raised.
    """
    from valor.common.document import Document  # imports the YAML reader, which tables of JSON do not need

    document = Document.load(file)
    SeveralFaultsError.require_none(document.error(each.path, each.what) for each in faults(kind, document.content))
    table = checked(kind, document.content)
    for broken in violations(table):
        raise document.error(broken.path, broken.what)
    return table


def faults(kind: Any, content: object, path: tuple[str, ...] = ()) -> list[TableError]:
    """All faults in plain values of a table, or of a part of one at ``path``; ``checked`` raises the first."""
    if not path and (infinite := list(_infinite(content))):
        return infinite
    try:
        msgspec.convert(content, kind, dec_hook=_other_type)
    except msgspec.ValidationError as error:
        rejected = error
    else:
        return []
    kinds = list(_alternatives(kind))
    found = []
    for key, inner, part in _parts(kinds, content):
        found += [TableError((*path, key), inner)] if isinstance(inner, str) else faults(inner, part, (*path, key))
    if not found and isinstance(rule := rejected.__cause__, TableError):
        return [TableError((*path, *rule.path), rule.what)]
    return found or [TableError(path, _explained(kinds, content, str(rejected)))]


def _alternatives(kind: Any) -> Iterator[Any]:
    """The types of a union; of one that is annotated, the type and the annotations."""
    if get_origin(kind) in {Union, UnionType, Annotated}:
        for each in get_args(kind):
            yield from _alternatives(each)
    else:
        yield kind


def _parts(kinds: Sequence[Any], content: object) -> Iterator[tuple[str, Any, Any]]:
    """Key, type and value of each part of a mapping or list; for a wrong key, a text about it instead of the type."""
    for kind in kinds:
        origin, arguments = get_origin(kind), get_args(kind)
        if isinstance(content, dict) and origin is dict:
            yield from ((str(key), arguments[1], part) for key, part in content.items())
        elif isinstance(content, list) and (origin is list or arguments[1:] == (...,)):
            yield from ((str(index), arguments[0], part) for index, part in enumerate(content))
        elif isinstance(content, list) and origin is tuple and len(arguments) == len(content):
            yield from ((str(index), *pair) for index, pair in enumerate(zip(arguments, content, strict=True)))
    tables = [each for each in kinds if isinstance(each, type) and issubclass(each, msgspec.Struct)]
    if not tables or not isinstance(content, dict):
        return
    tag = tables[0].__struct_config__.tag_field
    if len(tables) > 1:
        choices = " or ".join(sorted(str(each.__struct_config__.tag) for each in tables))
        tables = [each for each in tables if each.__struct_config__.tag == content.get(tag)]
        if not tables:
            yield str(tag), f"expected {choices}, got {content[tag]!r}" if tag in content else _MISSING, None
            return
    fields = {field.encode_name: field for field in msgspec.structs.fields(tables[0])}
    for key, part in content.items():
        if key in fields:
            yield key, fields[key].type, part
        elif key != tag:
            from difflib import get_close_matches

            near = "".join(f"; did you mean {each!r}?" for each in get_close_matches(str(key), fields, n=1))
            yield str(key), f"unknown key{near}", part
    yield from ((key, _MISSING, None) for key, each in fields.items() if each.required and key not in content)


def _infinite(content: object, path: tuple[str, ...] = ()) -> Iterator[TableError]:
    if isinstance(content, float) and not math.isfinite(content):
        yield TableError(path, f"expected a finite number, got {content}")
    elif isinstance(content, dict | list):
        for key, value in content.items() if isinstance(content, dict) else enumerate(content):
            yield from _infinite(value, (*path, str(key)))


def _other_type(kind: type, value: object) -> object:
    if kind is Path and isinstance(value, str | Path):
        return Path(value)
    raise TypeError(f"expected a {kind.__name__.lower()}, got {value!r}")


def _explained(kinds: Sequence[Any], content: object, message: str) -> str:
    """Expectation and value: msgspec's message about one value in the words of these files."""
    if found := _CHOICE.fullmatch(message):
        literals = [each for kind in kinds for each in (kind, *get_args(kind)[:1]) if get_origin(each) is Literal]
        choices = sorted(str(value) for literal in literals for value in get_args(literal))
        return f"expected {' or '.join(choices)}, got {found[1]}"
    if isinstance(content, str | int | float):
        text = repr(content)
        message = f"{message.partition(', got ')[0]}, got {text if len(text) <= _LONGEST else text[:_LONGEST] + '…'}"
    units = [each.extra["unit"] for each in kinds if isinstance(each, msgspec.Meta) and each.extra]
    message = _BOUND.sub(lambda bound: " ".join([bound[0], *units]), message)
    message = _TYPES.sub(lambda types: " or ".join(_WORDS.get(kind, kind) for kind in types[1].split(" | ")), message)
    return message.replace("Expected", "expected", 1)
