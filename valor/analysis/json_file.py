"""Reading and writing a structure as a JSON file."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import msgspec

from valor.common.errors import ValorError

T = TypeVar("T", bound=msgspec.Struct)


def load(file: Path, of: type[T], error: type[ValorError], what: str) -> T:
    """Read one.

    Args:
        file: where it is.
        of: its type.
        error: the class to raise if it cannot be read or is none; the text names the file.
        what: should be there.
    """
    try:
        return msgspec.json.decode(file.read_bytes(), type=of)
    except OSError as wrong:
        raise error(f"{file}: {wrong.strerror}; expected {what}") from None
    except msgspec.DecodeError as wrong:
        raise error(f"{file}: {wrong}") from None


def save(content: msgspec.Struct, file: Path) -> Path:
    """Write it, for people to read, too; returns the file."""
    file.write_bytes(msgspec.json.format(msgspec.json.encode(content), indent=2) + b"\n")
    return file
