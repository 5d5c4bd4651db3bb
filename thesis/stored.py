"""Structures saved as JSON files."""

from __future__ import annotations

from pathlib import Path
from typing import Self

import msgspec

from thesis.errors import ResultError
from valor.common import whole_file


class Stored(msgspec.Struct, frozen=True):
    """A structure with a JSON file of its own."""

    @classmethod
    def load(cls, file: Path) -> Self:
        """Read one.

        Raises:
            ResultError: the file cannot be read, or its content is not of this type.
        """
        try:
            return msgspec.json.decode(file.read_bytes(), type=cls)
        except OSError as error:
            raise ResultError(f"{file}: {error.strerror}; expected a file that an experiment saved") from None
        except msgspec.DecodeError as error:
            raise ResultError(f"{file}: {error}") from None

    def save(self, file: Path) -> Path:
        """Write it, indented; returns the file."""
        whole_file.write(file, msgspec.json.format(msgspec.json.encode(self), indent=2).decode() + "\n")
        return file
