"""Where chunks go: into memory, or into a file that is there under its name when it is whole and proven, not before."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
from pathlib import Path
from typing import Protocol

import msgspec

from valor.common import whole_file
from valor.link.bulk.chunks import Chunks
from valor.link.bulk.wire import CHUNK, Described, checked_name
from valor.link.errors import BulkError

RESERVE = 256 * 2**20  # that stays free on the disk [B]
TOGETHER = 64  # chunks side by side that are written at once


class Sink(Protocol):
    """Of one thing."""

    chunks: Chunks

    def write(self, place: int, content: bytes) -> None:
        """A chunk, of the right length.

        Raises:
            BulkError: there is no room for it.
        """

    def note(self) -> None:
        """Keep what has come for another process."""

    def finish(self) -> bytes:
        """All is here: hold it against its digest, have it appear; the content, where it is in memory.

        May be called from another thread, and takes as long as the disk does.

        Raises:
            BulkError: it is not what was described, or cannot be kept; it is to be fetched anew.
        """

    def close(self) -> None:
        """For now; what has come stays."""

    def drop(self) -> None:
        """For good."""


class Memory:
    """For what is small."""

    def __init__(self, described: Described) -> None:
        self._described, self.chunks = described, Chunks(described.size)
        self._content = bytearray(described.size)

    def write(self, place: int, content: bytes) -> None:
        """As of ``Sink``."""
        self._content[place * CHUNK : place * CHUNK + len(content)] = content

    def note(self) -> None:
        """There is nothing that would outlive the process."""

    def finish(self) -> bytes:
        """As of ``Sink``."""
        found = bytes(self._content)
        if hashlib.sha256(found).digest() != self._described.digest:
            raise BulkError(f"{self._described.name}: other bytes than its SHA-256 says")
        return found

    def close(self) -> None:
        """Nothing is open."""

    def drop(self) -> None:
        """Nothing stays."""


class _Kept(msgspec.Struct, array_like=True):
    """Beside a file that is not whole."""

    digest: bytes
    chunks: bytes


class File:
    """In a folder; what has come outlives the process."""

    def __init__(self, folder: Path, described: Described) -> None:
        """Go on where this thing was left, or begin; all room that it needs is taken now.

        Raises:
            BulkError: there is no room, or the folder cannot be written.
            SealError: its name is none of a file.
        """
        self._described, self.chunks = described, Chunks(described.size)
        self._file = folder / checked_name(described.name)
        self._part, self._noted = (folder / f".{described.name}.{end}" for end in ("part", "chunks"))
        self._open = -1
        self._waiting: list[bytes] = []  # side by side, up to the one that would be ``_next``
        self._next = 0
        try:
            folder.mkdir(parents=True, exist_ok=True)
            flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
            self._open = os.open(self._part, flags, 0o600)
            self._begin(folder)
        except OSError as error:
            self.drop()
            raise BulkError(f"{self._file}: {error.strerror}") from None
        except BulkError:
            self.drop()
            raise

    def _begin(self, folder: Path) -> None:
        size = self._described.size
        if os.fstat(self._open).st_size == size and (kept := self._known()):
            self.chunks.restore(kept)
            return
        os.ftruncate(self._open, 0)
        free = shutil.disk_usage(folder).free
        if size + RESERVE > free:
            raise BulkError(
                f"{self._file}: {size} B, and {RESERVE} B that stay free; on its disk {free} B are free: make room"
            )
        if size:
            os.posix_fallocate(self._open, 0, size)
        self.note()

    def _known(self) -> bytes:
        """What an earlier process noted of this very thing; empty: nothing."""
        with contextlib.suppress(OSError, msgspec.DecodeError):
            kept = msgspec.msgpack.decode(self._noted.read_bytes(), type=_Kept)
            return kept.chunks if kept.digest == self._described.digest else b""
        return b""

    def write(self, place: int, content: bytes) -> None:
        """As of ``Sink``."""
        try:
            if place != self._next or len(self._waiting) == TOGETHER:
                self._flush()
        except OSError as error:
            raise BulkError(f"{self._file}: {error.strerror}") from None
        self._waiting.append(content)
        self._next = place + 1

    def _flush(self) -> None:
        if self._waiting:
            os.pwritev(self._open, self._waiting, (self._next - len(self._waiting)) * CHUNK)
            self._waiting.clear()

    def note(self) -> None:
        """As of ``Sink``. After a computer's crash it may tell of bytes never written: the digest shows it."""
        with contextlib.suppress(OSError):  # what is not noted is fetched again
            self._flush()
            whole_file.write(self._noted, msgspec.msgpack.encode(_Kept(self._described.digest, self.chunks.kept())))

    def finish(self) -> bytes:
        """As of ``Sink``."""
        try:
            self._flush()
            os.fdatasync(self._open)
            with open(self._part, "rb") as file:
                digest = hashlib.file_digest(file, "sha256").digest()
            if digest != self._described.digest:
                raise BulkError(f"{self._described.name}: other bytes than its SHA-256 says")
            os.replace(self._part, self._file)
            _sync(self._file.parent)
        except OSError as error:
            raise BulkError(f"{self._file}: {error.strerror}") from None
        self.drop()
        return b""

    def close(self) -> None:
        """As of ``Sink``."""
        if self._open >= 0:
            self.note()
            os.close(self._open)
            self._open = -1

    def drop(self) -> None:
        """As of ``Sink``."""
        if self._open >= 0:
            os.close(self._open)
            self._open = -1
        for each in (self._part, self._noted):
            with contextlib.suppress(OSError):
                each.unlink()


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
