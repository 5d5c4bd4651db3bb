"""The text that describes a ROS message type in a bag: its definition and those of all types that it contains."""

from __future__ import annotations

import os
import re
import sys
from functools import cache
from pathlib import Path

_PRIMITIVES = frozenset(
    {"bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16"}
    | {"int32", "uint32", "int64", "uint64", "string", "wstring"}
)
FEEDBACK = "_Feedback"  # ends the name of the type of an action's feedback
_SEPARATOR = "=" * 80
_FIELD = re.compile(r"(?P<type>[A-Za-z][\w/]*)\S*\s+[A-Za-z]\w*(?P<constant>\s*=)?")


class UnknownTypeError(Exception):
    """A message type is not installed here; the text is one line."""


def definition(type_name: str) -> str:
    """The definition of a type with its dependencies, as MCAP's ``ros2msg`` wants it.

    Args:
        type_name: as ``sensor_msgs/msg/JointState``.

    Raises:
        UnknownTypeError: the type, or one that it contains, is not installed.
    """
    text = _read(type_name)
    parts, seen = [text], {type_name}
    waiting = _contained(type_name, text)
    while waiting:
        name = waiting.pop(0)
        if name in seen:
            continue
        seen.add(name)
        text = _read(name)
        package, _, base = name.split("/")
        parts.append(f"{_SEPARATOR}\nMSG: {package}/{base}\n{text}")
        waiting += _contained(name, text)
    return "".join(part if part.endswith("\n") else part + "\n" for part in parts)


@cache
def _read(type_name: str) -> str:
    """The .msg file, or the feedback of an .action, from a sourced ROS 2 or from beside this Python's packages."""
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    for prefix in filter(None, prefixes):
        try:
            package, kind, base = type_name.split("/")
            folder = Path(prefix) / "share" / package / kind
            if kind == "action" and base.endswith(FEEDBACK):
                _goal, _result, feedback = (
                    (folder / f"{base.removesuffix(FEEDBACK)}.action").read_text().split("\n---\n")
                )
                return _qualified(package, feedback)
            return (folder / f"{base}.msg").read_text()
        except (ValueError, IndexError, OSError):
            continue
    raise UnknownTypeError(f"{type_name} is not installed here")


def _qualified(package: str, text: str) -> str:
    """With the package before every type of its own: readers look for a bare name beside the action, not in ``msg``."""
    lines = []
    for line in text.splitlines():
        match = _FIELD.match(line)
        bare = match is not None and match["type"] not in _PRIMITIVES and "/" not in match["type"]
        lines.append(f"{package}/{line}" if bare else line)
    return "\n".join(lines)


def _contained(type_name: str, text: str) -> list[str]:
    package = type_name.split("/", maxsplit=1)[0]
    names = []
    for line in text.splitlines():
        match = _FIELD.match(line.partition("#")[0].strip())
        if match is None or match["constant"] or match["type"] in _PRIMITIVES:
            continue
        parts = match["type"].split("/")
        names.append(f"{parts[0] if len(parts) > 1 else package}/msg/{parts[-1]}")
    return names
