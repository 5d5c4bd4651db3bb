"""ROS message types by name: definitions for bags, hashes, and Python classes.

Names are as ``sensor_msgs/msg/JointState``. Of actions, the types of their topics are supported: the hidden topic
``_action/feedback`` has ``…/action/<Action>_FeedbackMessage``, which contains ``…/action/<Action>_Feedback``.
"""

import importlib
import json
import os
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

_PRIMITIVES = frozenset(
    {"bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16"}
    | {"int32", "uint32", "int64", "uint64", "string", "wstring"}
)
_FEEDBACK, _FEEDBACK_MESSAGE = "_Feedback", "_FeedbackMessage"  # suffixes of an action's types
_SEPARATOR = "=" * 80
_FIELD = re.compile(r"(?P<type>[A-Za-z][\w/]*)\S*\s+[A-Za-z]\w*(?P<constant>\s*=)?")


class UnknownTypeError(Exception):
    """A message type is not installed."""


def definition(type_name: str) -> str:
    """Definition of a type, as ``sensor_msgs/msg/JointState``, and its dependencies, in MCAP's form ``ros2msg``.

    Raises UnknownTypeError: the type, or one that it contains, is not installed.
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
        parts.append(f"{_SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{text}")
        waiting += _contained(name, text)
    return "".join(part if part.endswith("\n") else part + "\n" for part in parts)


@cache
def type_hash(type_name: str) -> str:
    """Hash of a type's description (REP-2011, ``RIHS01_…``); empty if its package has none."""
    package, kind, base = type_name.split("/")
    file = (
        f"{base.removesuffix(_FEEDBACK_MESSAGE).removesuffix(_FEEDBACK)}.json" if kind == "action" else f"{base}.json"
    )
    for folder in _folders(package, kind):
        try:
            hashes = json.loads((folder / file).read_text())["type_hashes"]
        except (OSError, ValueError, KeyError):
            continue
        return next((str(each["hash_string"]) for each in hashes if each["type_name"] == type_name), "")
    return ""


def message_type(type_name: str) -> type:
    """Python class of a type. Raises UnknownTypeError: it is not installed."""
    package, kind, base = type_name.split("/")
    try:
        module = importlib.import_module(f"{package}.{kind}")
        if kind == "action" and base.endswith(_FEEDBACK_MESSAGE):
            message: type = getattr(module, base.removesuffix(_FEEDBACK_MESSAGE)).Impl.FeedbackMessage
            return message
        if kind == "action" and base.endswith(_FEEDBACK):
            feedback: type = getattr(module, base.removesuffix(_FEEDBACK)).Feedback
            return feedback
        found: type = getattr(module, base)
    except (ImportError, AttributeError):
        raise UnknownTypeError(f"{type_name} has no Python package here") from None
    return found


def _folders(package: str, kind: str) -> Iterator[Path]:
    """Folders of definitions: in a sourced ROS 2, then in this Python's prefix."""
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    return (Path(prefix) / "share" / package / kind for prefix in prefixes if prefix)


@cache
def _read(type_name: str) -> str:
    """Text of the .msg file, or the part of an .action."""
    try:
        package, kind, base = type_name.split("/")
    except ValueError:
        raise UnknownTypeError(f"{type_name} is not installed here") from None
    if kind == "action" and base.endswith(_FEEDBACK_MESSAGE):
        feedback = f"{package}/{kind}/{base.removesuffix('Message')}"
        return f"unique_identifier_msgs/UUID goal_id\n{feedback} feedback\n"
    for folder in _folders(package, kind):
        try:
            if base.endswith(_FEEDBACK):
                _goal, _result, text = (folder / f"{base.removesuffix(_FEEDBACK)}.action").read_text().split("\n---\n")
                return _qualified(package, text)
            return (folder / f"{base}.msg").read_text()
        except (ValueError, OSError):
            continue
    raise UnknownTypeError(f"{type_name} is not installed here")


def _qualified(package: str, text: str) -> str:
    """Add the package to its own types: readers search a bare name beside the action, not in ``msg``."""
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
        kind = "action" if parts[-1].endswith(_FEEDBACK) and "/action/" in type_name else "msg"
        names.append(f"{parts[0] if len(parts) > 1 else package}/{kind}/{parts[-1]}")
    return names
