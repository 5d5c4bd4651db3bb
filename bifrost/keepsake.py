"""What a daemon leaves on disk: its table, for those who must find somebody while it does not answer.

One file a computer beside the network file, mode 0600, always whole. What it says may be out of date: who is gone is in
nobody's way, who came since is not found.
"""

from __future__ import annotations

import contextlib
import logging
import os
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import msgspec

from bifrost import directory as d
from bifrost.network import Network, write_private

_REST = 0.2  # between two writings [s]
_log = logging.getLogger("bifrostd")
_decode = msgspec.msgpack.Decoder(d.Table).decode


class Keepsake:
    """Keeps a file to what a table says, in a thread of its own: a disk that stands still must not stop the daemon."""

    def __init__(self, file: Path | None) -> None:
        """``file``: None: nothing is left."""
        self._file = file
        self._disk = ThreadPoolExecutor(1, "keepsake")
        self._writing: Future[None] | None = None
        self._written = 0  # version of the table
        self._next = 0.0  # when it may be written again, monotonic [s]
        self._warned = False

    def update(self, version: int, table: Callable[[], d.Table]) -> None:
        """Begin to write what ``table`` gives, if its version is new, and now and then only."""
        now = time.monotonic()
        if self._file is None or version == self._written or now < self._next:
            return
        if self._writing is None or self._writing.done():
            self._written, self._next = version, now + _REST
            self._writing = self._disk.submit(self._write, d.encode(table()))

    def close(self) -> None:
        """A daemon that ends in order leaves nothing."""
        self._disk.shutdown()
        if self._file is not None and self._writing is not None:
            with contextlib.suppress(OSError):
                self._file.unlink()

    def _write(self, content: bytes) -> None:
        assert self._file is not None
        try:
            write_private(self._file, content)
        except OSError as error:
            if not self._warned:
                self._warned = True
                _log.warning("%s: %s; nobody is found by it while there is no bifrostd", self._file, error.strerror)


def recall(network: Network) -> list[d.NodeRecord]:
    """Whom this computer's daemon left on disk, but for processes of this computer that have ended since."""
    if network.keepsake is None:
        return []
    try:
        table = _decode(network.keepsake.read_bytes())
    except (OSError, msgspec.DecodeError, RecursionError):
        return []
    return [node for node in table.nodes if node.computer != network.computer.name or _runs(node.pid)]


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True  # somebody else's
    return True
