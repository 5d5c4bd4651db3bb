"""YAML files written by people, with the line and column of every key, according to YAML 1.2's core schema.

Errors: values that YAML 1.1 reads differently (``yes``, ``0300``, ``5:00``), duplicate keys, tags, several documents,
text that is not printable (control characters, marks that reorder text), and files that exceed a limit below, also
after expansion of their aliases.
"""

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NoReturn, Self

import yaml

from valor.common.errors import ConfigurationError

MAX_BYTES = 1 << 18  # ten times the largest file of the repository
MAX_DEPTH = 16  # nested mappings and lists, with aliases expanded
MAX_VALUES = 50_000  # with aliases expanded
_MAX_DIGITS = 18  # of an integer, which then fits in 64 bits
_TOO_DEEP = f"expected at most {MAX_DEPTH} nested mappings and lists"
_PLAIN, _TEXT, _COLLECTION = "plain", "text", "collection"  # tags of values that have none in the file

Location = tuple[int, int]
"""Line and column, from 1."""
Keys = tuple[str, ...]
"""Keys, and indices in lists, from the whole file to a value."""

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
    """A file's content (mappings, lists, texts, numbers, truth values, None), and the location of each key."""

    def __init__(self, file: Path, data: bytes) -> None:
        """Read a file's bytes; errors as of ``load``."""
        self.file = file
        self._locations: dict[Keys, Location] = {}
        self._count = 0  # values so far
        self._depth = 0  # mappings and lists that contain the present value
        if len(data) > MAX_BYTES:
            raise ConfigurationError(f"{file}: expected at most {MAX_BYTES} bytes")
        try:
            root = _Loader(data.decode()).get_single_node()
        except UnicodeDecodeError as error:
            line = data[: error.start].count(b"\n") + 1
            raise ConfigurationError(
                f"{file}:{line}: expected text in UTF-8, got byte {data[error.start]:#x}"
            ) from None
        except yaml.YAMLError as error:
            found = error if isinstance(error, yaml.MarkedYAMLError) else yaml.MarkedYAMLError(problem=str(error))
            problem = " ".join(", ".join(filter(None, (found.context, found.problem))).split())
            raise self._error(_location(found.problem_mark or found.context_mark), (), f"not YAML: {problem}") from None
        self.content: object = None if root is None else self._value(root, ())

    @classmethod
    def load(cls, file: Path) -> Self:
        """Read a file. Raises ConfigurationError with file, line and key if it is missing or has rejected content."""
        try:
            if file.exists() and not file.is_file():
                raise ConfigurationError(f"{file}: expected a file")
            with file.open("rb") as opened:
                return cls(file, opened.read(MAX_BYTES + 1))
        except OSError as error:
            raise ConfigurationError(f"{file}: {error.strerror}") from None

    def location(self, path: Iterable[str]) -> Location:
        """Location of a key; of the innermost mapping or list on its path, if the key is missing."""
        keys = tuple(path)
        while keys and keys not in self._locations:
            keys = keys[:-1]
        return self._locations.get(keys, (1, 1))

    def error(self, path: Iterable[str], what: str) -> ConfigurationError:
        """Error of one line about a key, or the whole file: the value found, and the expectation."""
        keys = tuple(path)
        return self._error(self.location(keys), keys, what)

    def _error(self, location: Location, keys: Keys, what: str) -> ConfigurationError:
        return ConfigurationError(
            f"{self.file}:{location[0]}:{location[1]}: {'.'.join(keys) or '(whole file)'}: {what}"
        )

    def _reject(self, node: yaml.Node, keys: Keys, what: str) -> NoReturn:
        raise self._error(_location(node.start_mark), keys, what)

    def _value(self, node: yaml.Node, keys: Keys) -> Any:
        if node.tag not in (_PLAIN, _TEXT, _COLLECTION):
            self._reject(node, keys, f"got the tag {node.tag}; expected a value without one")
        self._count += 1
        if self._count > MAX_VALUES:
            self._reject(node, keys, f"expected at most {MAX_VALUES} values, with aliases expanded")
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node, keys)
        self._depth += 1
        if self._depth > MAX_DEPTH:
            self._reject(node, keys, f"{_TOO_DEEP}, with aliases expanded")
        value: Any
        if isinstance(node, yaml.MappingNode):
            value = self._mapping(node, keys)
        else:
            value = []
            for index, child in enumerate(node.value):
                path = (*keys, str(index))
                self._locations[path] = _location(child.start_mark)
                value.append(self._value(child, path))
        self._depth -= 1
        return value

    def _mapping(self, node: yaml.MappingNode, keys: Keys) -> dict[str, Any]:
        parts: dict[str, tuple[yaml.Node, yaml.Node]] = {}  # key and value, but for the merge key
        merged: list[yaml.Node] = []
        for key_node, child in node.value:
            key = self._key(key_node, keys)
            if key in parts:
                what = f"duplicate key; also in line {_location(parts[key][0].start_mark)[0]}"
                self._reject(key_node, (*keys, key), what)
            parts[key] = (key_node, child)
            if key == "<<" and key_node.tag == _PLAIN:
                merged = child.value if isinstance(child, yaml.SequenceNode) else [child]
        if merged:
            del parts["<<"]
        value: dict[str, Any] = {}
        for source in reversed(merged):
            if not isinstance(source, yaml.MappingNode):
                self._reject(source, (*keys, "<<"), "expected a mapping, or a list of mappings")
            value |= self._value(source, keys)
        for key, (key_node, child) in parts.items():
            path = (*keys, key)
            self._locations[path] = _location(key_node.start_mark)
            value[key] = self._value(child, path)
        return value

    def _key(self, node: yaml.Node, keys: Keys) -> str:
        if not isinstance(node, yaml.ScalarNode):
            self._reject(node, keys, "got a mapping or a list as a key; expected text")
        key = self._value(node, keys)
        if not isinstance(key, str):
            self._reject(node, keys, f"got the key {key!r}; expected text, in quotes if necessary")
        return key

    def _scalar(self, node: yaml.ScalarNode, keys: Keys) -> Any:
        """A text, or a value that YAML 1.1 and 1.2 agree on."""
        text: str = node.value
        if not text.replace("\n", "").isprintable():
            self._reject(node, keys, f"got {text!r}; expected printable characters")
        if node.tag == _TEXT:  # in quotes, or a block
            return text
        if text in _WORDS:
            return _WORDS[text]
        for pattern, number in _NUMBERS:
            if pattern.fullmatch(text):
                return number(text)
        for pattern, expected in _AMBIGUOUS:
            if pattern.fullmatch(text):
                shown = text if len(text) <= 40 else f"{text[:37]}…"
                self._reject(node, keys, f"got {shown}; expected {expected}, or quotes around text")
        return text


class _Loader(yaml.CSafeLoader):
    """libyaml's composer with a limit of depth; it leaves the type of plain values open."""

    depth = 0

    def descend_resolver(self, parent: yaml.Node | None, _index: object) -> None:
        """Limit the depth: the composer is recursive, and has no limit."""
        self.depth += 1
        if self.depth > MAX_DEPTH + 1 and parent is not None:  # the last level may be a plain value
            raise yaml.MarkedYAMLError(problem=_TOO_DEEP, problem_mark=parent.start_mark)

    def ascend_resolver(self) -> None:
        """Leave a value."""
        self.depth -= 1

    def resolve(self, kind: type[yaml.Node], _value: str, implicit: tuple[bool, bool]) -> str:
        """Tag of a value without one."""
        if kind is not yaml.ScalarNode:
            return _COLLECTION
        return _PLAIN if implicit[0] else _TEXT


def _location(mark: Any) -> Location:
    return (mark.line + 1, mark.column + 1) if mark else (1, 1)
