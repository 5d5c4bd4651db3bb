"""A bag of ours from outside: its place, and the bytes that it begins with, finished or not.

Read without the MCAP library: to import that takes a third of the time that `valorctl status` has for everything.
"""

from __future__ import annotations

import struct
from pathlib import Path

SUFFIX = ".mcap"
PROFILE, LIBRARY = "ros2", "valor"  # of each bag of ours
_MAGIC = b"\x89MCAP0\r\n"  # https://mcap.dev/spec
_HEADER, _METADATA = 0x01, 0x0C  # opcodes of records
_RECORD = struct.Struct("<BQ")  # opcode, length
_LENGTH = struct.Struct("<I")  # of a string, or of a map
_LARGEST_ORIGIN = 1 << 20  # [B]


def is_own_folder(bag: Path) -> bool:
    """Whether a bag stands in a folder of its own name: ``walk/walk.mcap``, ``walk/walk_1.mcap``."""
    folder = bag.parent.name
    return bag.stem == folder or bag.stem.startswith(f"{folder}_")


def origin(bag: Path) -> dict[str, str]:
    """Where a bag of ours comes from, finished or not: the metadata record that it begins with; empty: it has none.

    Raises:
        OSError: it cannot be read.
    """
    with open(bag, "rb") as file:
        file.seek(len(BEGINNING))
        head = file.read(_RECORD.size)
        opcode, length = _RECORD.unpack(head) if len(head) == _RECORD.size else (0, 0)
        if opcode != _METADATA or length > _LARGEST_ORIGIN:
            return {}
        content = file.read(length)
    try:
        _, values = _taken(content)  # its name
        (size,) = _LENGTH.unpack_from(values)
        return _map(values[_LENGTH.size :][:size]) if len(content) == length else {}
    except (struct.error, ValueError):
        return {}  # not written yet, or damaged


def _map(content: bytes) -> dict[str, str]:
    found = {}
    while content:
        key, content = _taken(content)
        found[key], content = _taken(content)
    return found


def _taken(content: bytes) -> tuple[str, bytes]:
    """A string, and what follows it."""
    (size,) = _LENGTH.unpack_from(content)
    string, rest = content[_LENGTH.size :][:size], content[_LENGTH.size + size :]
    if len(string) < size:
        raise ValueError("cut off")
    return string.decode(), rest


def _beginning() -> bytes:
    strings = b"".join(_LENGTH.pack(len(text)) + text.encode() for text in (PROFILE, LIBRARY))
    return _MAGIC + _RECORD.pack(_HEADER, len(strings)) + strings


BEGINNING = _beginning()
"""What each bag of ours begins with."""
