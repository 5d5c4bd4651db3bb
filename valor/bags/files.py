"""Files of bags: location, and the first bytes of a bag of this product, finished or not.

Read without the MCAP library, whose import would lengthen `valorctl status` by a third.
"""

import struct
from pathlib import Path

SUFFIX = ".mcap"
PROFILE, LIBRARY = "ros2", "valor"  # in the header of every bag of this product
_MAGIC = b"\x89MCAP0\r\n"  # https://mcap.dev/spec
_HEADER, _METADATA = 0x01, 0x0C  # opcodes of records
_RECORD = struct.Struct("<BQ")  # opcode, length
_LENGTH = struct.Struct("<I")  # of a string, or of a map
_LARGEST_ORIGIN = 1 << 20  # [B]


def _beginning() -> bytes:
    strings = b"".join(_LENGTH.pack(len(text)) + text.encode() for text in (PROFILE, LIBRARY))
    return _MAGIC + _RECORD.pack(_HEADER, len(strings)) + strings


BEGINNING = _beginning()
"""First bytes of every bag of this product."""


def is_own_folder(bag: Path) -> bool:
    """Return whether a bag is in a folder of its own name: ``walk/walk.mcap``, ``walk/walk_1.mcap``."""
    folder = bag.parent.name
    return bag.stem == folder or bag.stem.startswith(f"{folder}_")


def origin(bag: Path) -> dict[str, str]:
    """Metadata record at the start of a bag of this product; empty if it has none. Raises ``OSError``."""
    with open(bag, "rb") as file:
        file.seek(len(BEGINNING))
        content = file.read(_LARGEST_ORIGIN)
    strings: list[str] = []  # name of the record, then keys and values
    try:
        opcode, length = _RECORD.unpack_from(content)
        position, end = _RECORD.size, _RECORD.size + length
        while opcode == _METADATA and position < end <= len(content):
            (size,) = _LENGTH.unpack_from(content, position)
            position += _LENGTH.size
            strings.append(content[position : position + size].decode())
            position += size
            if len(strings) == 1:
                position += _LENGTH.size  # of the map
    except (struct.error, UnicodeDecodeError):
        return {}  # incomplete or damaged
    return dict(zip(strings[1::2], strings[2::2], strict=False))
