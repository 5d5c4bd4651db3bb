"""Tables: what stands in a file, as data classes whose values are checked when they are read.

msgspec checks them, which every process has for its messages anyway; pydantic would take ten MiB of each. In return the
keys that msgspec's complaints leave open, and its words, are filled in here.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, TypeVar, dataclass_transform

import msgspec.inspect

from valor.common.errors import ConfigurationError

Positive = Annotated[float, msgspec.Meta(gt=0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0)]

_PLACE = re.compile(r"(?P<what>.*?)(?: - at `(?:(?P<of_key>key)` in `)?\$(?P<path>.*)`)?", re.DOTALL)
_PART = re.compile(r"\.([^.\[]+)|\[(\d+|\.\.\.)\]")
_JSON = re.compile(r"`(\w+)`|Expected")
_WORDS = {None: "expected", "object": "a mapping", "array": "a list", "null": "nothing"}
_CHOICE = re.compile(r"Invalid (?:enum )?value (.*)")
_FIELD = re.compile(r"Object (missing required|contains unknown) field `(.*)`")


@dataclass_transform(frozen_default=True, kw_only_default=True)
class _TableMeta(msgspec.StructMeta):
    """msgspec does not hand ``kw_only`` down to subclasses; where it matters to mypy they say it, too."""

    def __new__(cls, name: str, bases: tuple[type, ...], namespace: dict[str, Any], **options: Any) -> _TableMeta:
        return super().__new__(cls, name, bases, namespace, **({"kw_only": True} | options))


class Table(msgspec.Struct, metaclass=_TableMeta, frozen=True, forbid_unknown_fields=True):
    """A part of a file: unknown keys are errors, numbers are finite, values are fixed once read.

    Rules that hold between values stand in ``__post_init__``, which raises ``ValueError``.
    """


T = TypeVar("T", bound=Table)


class TableError(ValueError):
    """A value that its table does not allow.

    Attributes:
        key: its place, as ``joints.l_knee_pitch.velocity``; empty: the whole.
        what: was expected there.
    """

    def __init__(self, key: str, what: str) -> None:
        super().__init__(f"{key or '(whole file)'}: {what}")
        self.key = key
        self.what = what


def checked(kind: type[T], content: object) -> T:
    """Make a table of plain values.

    Raises:
        TableError: names the first key that is wrong.
    """
    for keys, number in _infinite(content):
        raise TableError(keys, f"expected a finite number, got {number}")
    try:
        return msgspec.convert(content, kind, dec_hook=_other_type)
    except msgspec.ValidationError as error:
        raise _explained(kind, content, str(error)) from None


def plain(table: Table) -> dict[str, Any]:
    """What ``checked`` would make the same table of."""
    content: dict[str, Any] = msgspec.to_builtins(table, enc_hook=str)
    return content


def read(kind: type[T], file: Path) -> T:
    """Make a table of a YAML file.

    Raises:
        ConfigurationError: the file or a key is missing or wrong; in one line that names both.
    """
    import yaml  # not for those who take tables of JSON alone

    try:
        return checked(kind, yaml.safe_load(file.read_text()))
    except OSError as error:
        raise ConfigurationError(f"{file}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{file}: expected text") from None
    except yaml.YAMLError as error:
        raise ConfigurationError(f"{file}: not YAML: {' '.join(str(error).split())}") from None
    except TableError as error:
        raise ConfigurationError(f"{file}: {error}") from None


def _infinite(content: object, path: str = "") -> Iterator[tuple[str, float]]:
    """Numbers that are none, and where."""
    if isinstance(content, float):
        if not math.isfinite(content):
            yield path, content
    elif isinstance(content, dict | list):
        for key, value in content.items() if isinstance(content, dict) else enumerate(content):
            yield from _infinite(value, f"{path}.{key}" if path else str(key))


def _other_type(kind: type, value: object) -> object:
    """What msgspec does not know by itself."""
    if kind is Path and isinstance(value, str | Path):
        return Path(value)
    raise TypeError(f"expected a {kind.__name__.lower()}, got {value!r}")


def _explained(kind: type[Table], content: object, complaint: str) -> TableError:
    """Msgspec's complaint in our words, with all keys named."""
    match = _PLACE.fullmatch(complaint)
    assert match is not None  # all of it is optional
    parts = [name or index for name, index in _PART.findall(match["path"] or "")]
    keys = _keys(kind, content, complaint, parts)
    what: str = match["what"]
    if field := _FIELD.fullmatch(what):
        keys.append(field[2])
        what = "expected, but missing" if field[1] == "missing required" else "unknown key"
    elif value := _CHOICE.fullmatch(what):
        choices = _choices(msgspec.inspect.type_info(kind), parts, bool(match["of_key"]))
        what = f"expected {' or '.join(sorted(map(str, choices)))}, got {value[1]}"
    return TableError(".".join(keys), _JSON.sub(lambda word: _WORDS.get(word[1], word[1]), what))


def _keys(kind: type[Table], content: object, complaint: str, parts: list[str]) -> list[str]:
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


def _choices(kind: Any, parts: list[str], of_key: bool) -> tuple[Any, ...]:
    """The values that are allowed at a place, or of a mapping's keys."""
    if isinstance(kind, msgspec.inspect.Metadata):
        return _choices(kind.type, parts, of_key)
    if isinstance(kind, msgspec.inspect.UnionType):
        return tuple(choice for one in kind.types for choice in _choices(one, parts, of_key))
    if not parts:
        found = getattr(kind, "key_type", None) if of_key else kind
        return found.values if isinstance(found, msgspec.inspect.LiteralType) else ()
    if isinstance(kind, msgspec.inspect.StructType):
        if kind.tag_field == parts[0]:
            return (kind.tag,)
        inner = next((field.type for field in kind.fields if field.encode_name == parts[0]), None)
    else:
        inner = getattr(kind, "value_type", None) or getattr(kind, "item_type", None)
    return _choices(inner, parts[1:], of_key)


def _complaint(kind: type[Table], content: object) -> str:
    try:
        msgspec.convert(content, kind, dec_hook=_other_type)
    except msgspec.ValidationError as error:
        return str(error)
    return ""
