"""What the robot's end has to give: things in memory, and files."""

from __future__ import annotations

import hashlib
import os
import stat
from pathlib import Path
from typing import Protocol

from valor.link.bulk.wire import Described
from valor.link.classes import Bulk
from valor.link.errors import BulkError


class Thing(Protocol):
    """Attributes:
    described: as the other end is told.
    """

    described: Described

    def read(self, at: int, size: int) -> bytes:
        """Some bytes of it.

        Raises:
            BulkError: it is not what it was.
        """

    def close(self) -> None:
        """Nobody reads it any more."""


class Shelf(Protocol):
    """Where the robot's end finds them. Asked from the loop's thread: nothing here may wait."""

    def newest(self) -> tuple[Thing, ...]:
        """The newest picture and the newest list of bags, as far as they are there."""

    def find(self, name: str) -> Thing | None:
        """A bag; None: it is being looked at, and may be had later.

        Raises:
            BulkError: it is not to be had.
        """


class Held:
    """A thing in memory."""

    def __init__(self, kind: Bulk, name: str, content: bytes, clock: int = 0, form: str = "") -> None:
        self._content = content
        self.described = Described(kind, name, len(content), hashlib.sha256(content).digest(), clock, form)

    def read(self, at: int, size: int) -> bytes:
        """As of ``Thing``."""
        return self._content[at : at + size]

    def close(self) -> None:
        """Nothing is open."""


class Opened:
    """A file, as it was when it was opened.

    Attributes:
        identity: changes when the file does.
        described: a bag.
    """

    def __init__(self, path: Path) -> None:
        """Open it.

        Raises:
            BulkError: it is no file, or cannot be read.
        """
        self._name = path.name
        try:
            self._open = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
        except OSError as error:
            raise BulkError(f"{self._name}: {error.strerror}") from None
        found = os.fstat(self._open)
        if not stat.S_ISREG(found.st_mode):
            os.close(self._open)
            raise BulkError(f"{self._name}: expected a file")
        self.identity = (str(path), found.st_ino, found.st_size, found.st_mtime_ns)

    def digest(self) -> bytes:
        """SHA-256 of all of it, from any thread; takes as long as the disk does."""
        found, at = hashlib.sha256(), 0
        while block := os.pread(self._open, 1 << 20, at):
            found.update(block)
            at += len(block)
        return found.digest()

    def describe(self, digest: bytes) -> None:
        """Give what ``digest`` found."""
        self.described = Described(Bulk.BAG, self._name, self.identity[2], digest)

    def read(self, at: int, size: int) -> bytes:
        """As of ``Thing``."""
        found = os.fstat(self._open)
        if (found.st_size, found.st_mtime_ns) != self.identity[2:]:
            raise BulkError(f"{self._name}: it has changed")
        return os.pread(self._open, size, at)

    def close(self) -> None:
        """As of ``Thing``."""
        os.close(self._open)
