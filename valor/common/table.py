"""Tables: what stands in a file, as data classes whose values are checked when they are read.

msgspec checks them, which every process has for its messages anyway; pydantic would take ten MiB of each. In return the
keys that msgspec's complaints leave open, and its words, are filled in here.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, dataclass_transform, get_args, get_origin

import msgspec.inspect

from valor.common.errors import SeveralFaultsError

Positive = Annotated[float, msgspec.Meta(gt=0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0)]

_PLACE = re.compile(r"(?P<what>.*?)(?: - at `(?:(?P<of_key>key)` in `)?\$(?P<path>.*)`)?", re.DOTALL)
_PART = re.compile(r"\.([^.\[]+)|\[(\d+|\.\.\.)\]")
_JSON = re.compile(r"`([\w |]+)`|Expected")
_WORDS = {"object": "a mapping", "array": "a list", "null": "nothing"}
_BOUND = re.compile(r"[<>]=? [\d.e+-]+")
_CHOICE = re.compile(r"Invalid (?:enum )?value (.*)")
_FIELD = re.compile(r"Object (missing required|contains unknown) field `(.*)`")


@dataclass_transform(frozen_default=True, kw_only_default=True)
class _TableMeta(msgspec.StructMeta):
    """msgspec does not hand ``kw_only`` down to subclasses; where it matters to mypy they say it, too."""

    def __new__(cls, name: str, bases: tuple[type, ...], namespace: dict[str, Any], **options: Any) -> _TableMeta:
        return super().__new__(cls, name, bases, namespace, **({"kw_only": True} | options))


class Table(msgspec.Struct, metaclass=_TableMeta, frozen=True, forbid_unknown_fields=True):
    """A part of a file: unknown keys are errors, numbers are finite, values are fixed once read.

    Rules that hold between values stand in ``__post_init__``, which raises ``TableError`` with the path from the table.
    """


T = TypeVar("T", bound=Table)
_LONGEST = 40  # value that a complaint repeats


class TableError(ValueError):
    """A value that its table does not allow.

    Attributes:
        path: keys, and places in lists, that lead to it; empty: the whole.
        key: the same as one text: ``joints.l_knee_pitch.velocity``.
        what: was found, and was expected there.
    """

    def __init__(self, path: Sequence[str], what: str) -> None:
        self.path = tuple(path)
        self.key = ".".join(self.path)
        self.what = what
        super().__init__(f"{self.key or '(whole file)'}: {what}")


def checked(kind: type[T], content: object) -> T:
    """Make a table of plain values.

    Raises:
        TableError: names the first key that is wrong.
    """
    for path, number in _infinite(content):
        raise TableError(path, f"expected a finite number, got {number}")
    try:
        return msgspec.convert(content, kind, dec_hook=_other_type)
    except msgspec.ValidationError as error:
        raise _explained(kind, content, error) from None


def require_order(table: Table, lower: str, upper: str) -> None:
    """Raise ``TableError`` unless one number of a table is less than another."""
    one, other = getattr(table, lower), getattr(table, upper)
    if one >= other:
        raise TableError((lower,), f"got {one}; expected less than {upper}, {other}")


def plain(table: Table) -> dict[str, Any]:
    """What ``checked`` would make the same table of."""
    content: dict[str, Any] = msgspec.to_builtins(table, enc_hook=str)
    return content


def read(kind: type[T], file: Path) -> T:
    """Make a table of a YAML file.

    Raises:
        ConfigurationError: the file or a key is missing or wrong; in one line with file, line, column and key.
    """
    from valor.common.document import Document  # with a YAML reader: not for those who take tables of JSON alone

    document = Document.load(file)
    SeveralFaultsError.require_none(document.error(each.path, each.what) for each in faults(kind, document.content))
    return checked(kind, document.content)


def faults(kind: Any, content: object, path: tuple[str, ...] = ()) -> list[TableError]:
    """All that is wrong in plain values of a table, mapping or list; ``checked`` raises the first.

    Args:
        kind: a table's class, or the type of what stands in one.
        content: plain values.
        path: that leads to them.
    """
    if not path and (wrong := list(_infinite(content))):
        return [TableError(where, f"expected a finite number, got {number}") for where, number in wrong]
    try:
        msgspec.convert(content, kind, dec_hook=_other_type)
    except msgspec.ValidationError as error:
        whole = _explained(kind, content, error)
    else:
        return []
    found = [TableError((*path, key), what) for key, what in _astray(kind, content)]
    for key, inner in _inner(kind, content):
        part = content[int(key)] if isinstance(content, list) else content[key]  # type: ignore[index]
        found += faults(inner, part, (*path, key))
    return found or [TableError((*path, *whole.path), whole.what)]


def _astray(kind: Any, content: object) -> Iterator[tuple[str, str]]:
    """Keys of a table that are missing, or that it has not, and what to say of them."""
    if not (isinstance(content, dict) and isinstance(kind, type) and issubclass(kind, msgspec.Struct)):
        return
    fields = msgspec.structs.fields(kind)
    known = [field.encode_name for field in fields]
    for key in content:
        if key not in known and key != kind.__struct_config__.tag_field:
            yield str(key), _unknown(str(key), known)
    for field in fields:
        if field.required and field.encode_name not in content:
            yield field.encode_name, "expected, but missing"


def _unknown(key: str, known: Sequence[str]) -> str:
    import difflib

    return "unknown key" + "".join(f"; did you mean {near!r}?" for near in difflib.get_close_matches(key, known, n=1))


def _inner(kind: Any, content: object) -> Iterator[tuple[str, Any]]:
    """The keys of a value that is no scalar, with the type of what belongs there."""
    arguments = get_args(kind)
    if get_origin(kind) in {Union, UnionType} and isinstance(content, dict | list):
        structures = [each for each in arguments if each is not type(None)]
        if len(structures) == 1:
            yield from _inner(structures[0], content)
    elif get_origin(kind) is Annotated:
        yield from _inner(arguments[0], content)
    elif isinstance(content, dict) and isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        for field in msgspec.structs.fields(kind):
            if field.encode_name in content:
                yield field.encode_name, field.type
    elif isinstance(content, dict) and get_origin(kind) is dict:
        yield from ((str(key), arguments[1]) for key in content)
    elif isinstance(content, list) and get_origin(kind) is list:
        yield from ((str(place), arguments[0]) for place in range(len(content)))


def _infinite(content: object, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], float]]:
    """Numbers that are none, and where."""
    if isinstance(content, float):
        if not math.isfinite(content):
            yield path, content
    elif isinstance(content, dict | list):
        for key, value in content.items() if isinstance(content, dict) else enumerate(content):
            yield from _infinite(value, (*path, str(key)))


def _other_type(kind: type, value: object) -> object:
    """What msgspec does not know by itself."""
    if kind is Path and isinstance(value, str | Path):
        return Path(value)
    raise TypeError(f"expected a {kind.__name__.lower()}, got {value!r}")


def _explained(kind: Any, content: object, error: msgspec.ValidationError) -> TableError:
    """Msgspec's complaint in our words, with all keys named."""
    complaint = str(error)
    match = _PLACE.fullmatch(complaint)
    assert match is not None  # all of it is optional
    parts = [name or index for name, index in _PART.findall(match["path"] or "")]
    keys = _keys(kind, content, complaint, parts)
    if isinstance(rule := error.__cause__, TableError):
        return TableError([*keys, *rule.path], rule.what)
    what: str = match["what"]
    if field := _FIELD.fullmatch(what):
        keys.append(field[2])
        known = [each.encode_name for struct in _types(kind, parts) for each in getattr(struct, "fields", ())]
        what = "expected, but missing" if field[1] == "missing required" else _unknown(field[2], known)
    elif value := _CHOICE.fullmatch(what):
        choices = _choices(kind, parts, bool(match["of_key"]))
        what = f"expected {' or '.join(sorted(map(str, choices)))}, got {value[1]}"
    else:
        what = _BOUND.sub(rf"\g<0>{_unit(kind, parts)}", _with_value(what, content, keys))
    return TableError(keys, _JSON.sub(_in_words, what))


def _in_words(found: re.Match[str]) -> str:
    return " or ".join(_WORDS.get(kind, kind) for kind in found[1].split(" | ")) if found[1] else "expected"


def _keys(kind: Any, content: object, complaint: str, parts: list[str]) -> list[str]:
    """The path to what is wrong; ``...`` in ``parts`` is some key of a mapping.

    It is the one without whose siblings the complaint is the same.
    """
    whole = here = copy.deepcopy(content)
    keys = []
    for part in parts:
        if part == "..." and isinstance(here, dict):
            siblings = dict(here)
            for key, value in siblings.items():
                here.clear()
                here[key] = value
                if _complaint(kind, whole) == complaint:
                    break
            part, here = str(key), value  # noqa: PLW2901
        elif isinstance(here, dict):
            here = here.get(part)
        elif isinstance(here, list):
            here = here[int(part)]
        keys.append(part)
    return keys


def _with_value(what: str, content: Any, path: Sequence[str]) -> str:
    """The complaint with the value that it is about, if that is short."""
    for key in path:
        content = content[int(key) if isinstance(content, list) else key]
    if not isinstance(content, str | int | float):
        return what
    text = repr(content)
    return f"{what.partition(', got ')[0]}, got {text if len(text) <= _LONGEST else text[:_LONGEST] + '…'}"


def _unit(kind: Any, parts: Sequence[str]) -> str:
    """Of the number at a place, with a blank before it: of its ``Meta(extra={"unit": ...})``; empty if it says none."""
    inner = [each for outer in _types(kind, parts[:-1]) for part in parts[-1:] for each in _parts(outer, part)]
    inner = inner if parts else [msgspec.inspect.type_info(kind)]
    found = [one for each in inner for one in (each.types if isinstance(each, msgspec.inspect.UnionType) else [each])]
    units = (each.extra.get("unit") for each in found if isinstance(each, msgspec.inspect.Metadata) and each.extra)
    return "".join(f" {unit}" for unit in units if unit)


def _choices(kind: Any, parts: Sequence[str], of_key: bool) -> Iterator[Any]:
    """The values that are allowed at a place, or of a mapping's keys."""
    for found in _types(kind, parts):
        literal = getattr(found, "key_type", None) if of_key else found
        if isinstance(literal, msgspec.inspect.LiteralType):
            yield from literal.values


def _types(kind: Any, parts: Sequence[str]) -> list[Any]:
    """What may stand at a place; ``parts`` lead there."""
    found: list[Any] = _alternatives(msgspec.inspect.type_info(kind))
    for part in parts:
        found = [each for outer in found for inner in _parts(outer, part) for each in _alternatives(inner)]
    return found


def _parts(kind: Any, part: str) -> Iterator[Any]:
    if isinstance(kind, msgspec.inspect.StructType):
        if kind.tag_field == part:
            yield msgspec.inspect.LiteralType((kind.tag,))
        yield from (field.type for field in kind.fields if field.encode_name == part)
    elif inner := getattr(kind, "value_type", None) or getattr(kind, "item_type", None):
        yield inner


def _alternatives(kind: Any) -> list[Any]:
    """The types of a union; no constraints."""
    if isinstance(kind, msgspec.inspect.Metadata):
        return _alternatives(kind.type)
    if isinstance(kind, msgspec.inspect.UnionType):
        return [each for one in kind.types for each in _alternatives(one)]
    return [kind]


def _complaint(kind: Any, content: object) -> str:
    try:
        msgspec.convert(content, kind, dec_hook=_other_type)
    except msgspec.ValidationError as error:
        return str(error)
    return ""
