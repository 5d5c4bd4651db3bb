"""YAML as people write it: the one way into the system for every file of theirs.

Read as YAML 1.2's core schema has it. What YAML 1.1 reads otherwise (``yes``, ``0300``, ``5:00``) is an error and not a
guess; so are a key that stands twice, tags, several documents, and whatever is too large, too deep, or grows too large
once its aliases are put in. libyaml's events are put together here, one after the other: its own composer goes as deep
as the file does, and knows nothing of keys that stand twice.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import yaml
from yaml import events

from valor.common.errors import ConfigurationError

MAX_BYTES = 1 << 18  # ten times our largest
MAX_DEPTH = 16  # of mappings and lists in each other; aliases put in
MAX_VALUES = 50_000  # likewise
_MAX_DIGITS = 18  # of a whole number: it has its place in 64 bits

Place = tuple[int, int]
"""Line and column, from 1."""
Path_ = tuple[str, ...]
"""Keys, and places in lists, from the whole file to a value."""

_WORDS = dict.fromkeys(("", "~", "null", "Null", "NULL")) | {
    word: truth for truth in (True, False) for word in (str(truth), str(truth).lower(), str(truth).upper())
}
_NUMBERS: tuple[tuple[re.Pattern[str], Callable[[str], int | float]], ...] = (
    (re.compile(rf"[-+]?(0|[1-9][0-9]{{0,{_MAX_DIGITS - 1}}})"), int),
    (re.compile(r"0x[0-9a-fA-F]{1,15}"), lambda text: int(text, 16)),
    (re.compile(r"[-+]?(\.[0-9]+|[0-9]+\.[0-9]*|[0-9]+(?=[eE]))([eE][-+]?[0-9]+)?"), float),
    (re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"), lambda text: float(text.replace(".", ""))),
)
_AMBIGUOUS: tuple[tuple[re.Pattern[str], str], ...] = (
    (re.compile(r"(yes|no|on|off)", re.IGNORECASE), "true or false"),
    (re.compile(r"[-+]?0[0-9_]+|0o[0-7]*|[-+]?0b[01_]*"), "a decimal number without leading zeros"),
    (re.compile(r"[-+]?[0-9][0-9_]*(:[0-5]?[0-9])+(\.[0-9_]*)?"), "a decimal number in the key's unit"),
    (re.compile(r"[-+]?[0-9.][0-9._]*_[0-9._]*([eE][-+]?[0-9]+)?"), "a number without underscores"),
    (re.compile(r"[-+]?[0-9]+|0x[0-9a-fA-F]+"), f"a number of at most {_MAX_DIGITS} digits"),
    (re.compile(r"[0-9]{4}-[0-9]{1,2}-[0-9]{1,2}([Tt ].*)?"), "a date in quotes"),
)


class Document:
    """A file's content, and where each key of it stands.

    Attributes:
        file: it was read from.
        content: mappings, lists, texts, numbers, truth values and None. Shared where the file has an alias.
    """

    def __init__(self, file: Path, content: object, places: dict[int, dict[str | int, Place]]) -> None:
        self.file = file
        self.content = content
        self._places = places  # of mappings' and lists' parts, by the id of the mapping or list

    @classmethod
    def load(cls, file: Path) -> Document:
        """Read a file.

        Raises:
            ConfigurationError: it cannot be read, or is not what this module takes; names file, line and key.
        """
        try:
            if file.exists() and not file.is_file():
                raise ConfigurationError(f"{file}: expected a file")
            with file.open("rb") as opened:
                data = opened.read(MAX_BYTES + 1)
        except OSError as error:
            raise ConfigurationError(f"{file}: {error.strerror}") from None
        return cls.of(file, data)

    @classmethod
    def of(cls, file: Path, data: bytes) -> Document:
        """What ``load`` makes of a file's bytes."""
        if len(data) > MAX_BYTES:
            raise ConfigurationError(f"{file}: expected at most {MAX_BYTES} bytes")
        try:
            text = data.decode()
        except UnicodeDecodeError as error:
            line = data.count(b"\n", 0, error.start) + 1
            raise ConfigurationError(
                f"{file}:{line}: expected text in UTF-8, got byte 0x{data[error.start]:02x}"
            ) from None
        return _Builder(file).build(text)

    def place(self, path: Iterable[str]) -> Place:
        """Where a key stands; where there is none, the innermost of the mappings and lists that it would be in."""
        place, here = (1, 1), self.content
        for part in path:
            key = int(part) if isinstance(here, list) and part.isdecimal() else part
            found = self._places.get(id(here), {}).get(key)
            if found is None:
                break
            place = found
            here = here[key]  # type: ignore[index]  # whatever has places is a mapping or a list
        return place

    def error(self, path: Iterable[str], what: str) -> ConfigurationError:
        """One line that says what is wrong with a key.

        Args:
            path: of the key; empty: the whole file.
            what: was found there, and was expected.
        """
        keys = tuple(path)
        return _error(self.file, self.place(keys), keys, what)


def _error(file: Path, place: Place, path: Path_, what: str) -> ConfigurationError:
    return ConfigurationError(f"{file}:{place[0]}:{place[1]}: {'.'.join(path) or '(whole file)'}: {what}")


class _Merge(str):
    """The key << without quotes."""


_MERGE = _Merge("<<")


class _Node(NamedTuple):
    """A value that is complete."""

    value: Any
    size: int = 1  # values in it, itself included
    height: int = 0  # of mappings and lists in each other


class _Frame:
    """A mapping or list that is being read."""

    def __init__(self, value: dict[str, Any] | list[Any], anchor: str | None, place: Place) -> None:
        self.value = value
        self.anchor = anchor
        self.place = place  # where it begins
        self.places: dict[str | int, Place] = {}
        self.size, self.height = 1, 0
        self.key: str | None = None  # of the value that comes next
        self.merged: list[_Node] | None = None  # under the key <<

    @property
    def part(self) -> str:
        """What names the value that comes next."""
        return str(len(self.value)) if isinstance(self.value, list) else self.key or ""


class _Builder:
    """Puts a document together, event by event."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._stack: list[_Frame] = []
        self._anchors: dict[str, _Node] = {}
        self._places: dict[int, dict[str | int, Place]] = {}
        self._root: _Node | None = None
        self._place: Place = (1, 1)

    def build(self, text: str) -> Document:
        """The document of a text."""
        for event in self._events(text):
            self._place = _at(event.start_mark)
            if isinstance(event, events.ScalarEvent):
                self._require_plain(event)
                self._complete(self._scalar(event), event.anchor)
            elif isinstance(event, events.CollectionStartEvent):
                self._require_plain(event)
                self._open({} if isinstance(event, events.MappingStartEvent) else [], event.anchor)
            elif isinstance(event, events.CollectionEndEvent):
                self._close()
            elif isinstance(event, events.AliasEvent):
                if event.anchor not in self._anchors:
                    self._refuse(f"got *{event.anchor}; expected one of the anchors that stand before it")
                self._complete(self._anchors[event.anchor], None)
            elif isinstance(event, events.DocumentStartEvent) and self._root is not None:
                self._refuse("got a second document (---); expected one")
        return Document(self._file, self._root.value if self._root else None, self._places)

    def _events(self, text: str) -> Iterator[events.Event]:
        """libyaml's; its complaints as ours."""
        try:
            yield from yaml.parse(text, Loader=yaml.CSafeLoader)
        except yaml.MarkedYAMLError as error:
            self._place = _at(error.problem_mark or error.context_mark)
            self._refuse(f"not YAML: {' '.join(str(error.problem or error.context).split())}")
        except yaml.YAMLError as error:
            self._refuse(f"not YAML: {' '.join(str(error).split())}")

    def _require_plain(self, event: events.ScalarEvent | events.CollectionStartEvent) -> None:
        if event.tag is not None:
            self._refuse(f"got the tag {event.tag}; expected a value without one")
        if event.anchor in self._anchors or (event.anchor and any(f.anchor == event.anchor for f in self._stack)):
            self._refuse(f"got a second anchor &{event.anchor}; expected another name")

    def _scalar(self, event: events.ScalarEvent) -> _Node:
        """A text, or what YAML 1.1 and 1.2 agree that it means."""
        text: str = event.value
        if not event.implicit[0]:  # in quotes, or a block
            return _Node(text)
        if text == "<<" and self._expects_key():
            return _Node(_MERGE)
        if text in _WORDS:
            return _Node(_WORDS[text])
        for pattern, number in _NUMBERS:
            if pattern.fullmatch(text):
                return _Node(number(text))
        for pattern, wanted in _AMBIGUOUS:
            if pattern.fullmatch(text):
                self._refuse(f"got {_short(text)}; expected {wanted}, or quotes around text")
        return _Node(text)

    def _expects_key(self) -> bool:
        return bool(self._stack) and isinstance(self._stack[-1].value, dict) and self._stack[-1].key is None

    def _open(self, value: dict[str, Any] | list[Any], anchor: str | None) -> None:
        if self._expects_key():
            self._refuse("got a mapping or a list as a key; expected text")
        self._stack.append(_Frame(value, anchor, self._place))
        if len(self._stack) > MAX_DEPTH:
            self._refuse(f"expected at most {MAX_DEPTH} mappings and lists in each other")

    def _close(self) -> None:
        frame = self._stack.pop()
        value, places = frame.value, frame.places
        if isinstance(value, dict) and frame.merged is not None:
            sources = [node.value for node in reversed(frame.merged)]
            value = {key: part for source in (*sources, value) for key, part in source.items()}
            places = {key: at for source in sources for key, at in self._places[id(source)].items()} | places
        self._places[id(value)] = places
        self._place = frame.place
        self._complete(_Node(value, frame.size, frame.height), frame.anchor)

    def _complete(self, node: _Node, anchor: str | None) -> None:
        """Put a value into its mapping or list."""
        if anchor is not None:
            self._anchors[anchor] = node
        if not self._stack:
            self._root = node
            return
        frame = self._stack[-1]
        if isinstance(frame.value, dict) and frame.key is None:
            self._take_key(frame, node.value)
            return
        frame.size += node.size
        frame.height = max(frame.height, node.height + 1)
        if frame.size > MAX_VALUES or len(self._stack) + node.height > MAX_DEPTH:
            self._refuse(f"expected at most {MAX_VALUES} values, {MAX_DEPTH} deep, once aliases are put in")
        if isinstance(frame.value, list):
            frame.places[len(frame.value)] = self._place
            frame.value.append(node.value)
        else:
            if frame.key is _MERGE:
                frame.merged = self._mappings(node)
            else:
                frame.value[frame.part] = node.value
            frame.key = None

    def _take_key(self, frame: _Frame, key: object) -> None:
        if not isinstance(key, str):
            self._refuse(f"got the key {_short(repr(key))}; expected text, in quotes if need be")
        frame.key = key
        if key in frame.places or (key is _MERGE and frame.merged is not None):
            self._refuse("stands twice" + (f", in line {frame.places[key][0]}, too" if key in frame.places else ""))
        if key is not _MERGE:
            frame.places[key] = self._place

    def _mappings(self, node: _Node) -> list[_Node]:
        """What stands under the key <<."""
        nodes = [_Node(value) for value in node.value] if isinstance(node.value, list) else [node]
        if not all(isinstance(each.value, dict) for each in nodes):
            self._refuse("expected a mapping, or a list of them")
        return nodes

    def _refuse(self, what: str) -> NoReturn:
        path = tuple(part for frame in self._stack if (part := frame.part))
        raise _error(self._file, self._place, path, what)


def _at(mark: Any) -> Place:
    """Where one of libyaml's marks is."""
    return (mark.line + 1, mark.column + 1) if mark else (1, 1)


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:37]}…"
