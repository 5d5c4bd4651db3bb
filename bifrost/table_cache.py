"""On-disk copy of the daemon's node table, for nodes created with ``recall=True`` while no daemon responds.

One file for each computer next to the network file, mode 0600, replaced atomically. It may be out of date.
"""

import contextlib
import logging
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import msgspec

from bifrost import directory as d
from bifrost.network import Network, write_private

_REST = 0.2  # minimum interval between writes [s]
_log = logging.getLogger("bifrostd")
_decode = msgspec.msgpack.Decoder(d.Table).decode


class TableCache:
    """Writes the table to a file in a separate thread, so that a blocked disk does not stop the daemon."""

    def __init__(self, file: Path | None) -> None:
        """``file``: None: no copy."""
        self._file = file
        self._disk = ThreadPoolExecutor(1, "table_cache")
        self._writing: Future[None] | None = None
        self._written = 0  # version of the table
        self._next = 0.0  # earliest time of the next write, monotonic [s]

    def update(self, version: int, table: Callable[[], d.Table]) -> None:
        """Start a write of ``table()`` if its version is new and the interval has passed."""
        now = time.monotonic()
        if self._file is None or version == self._written or now < self._next:
            return
        if self._writing is None or self._writing.done():
            self._written, self._next = version, now + _REST
            self._writing = self._disk.submit(self._write, self._file, d.encode(table()))

    def close(self) -> None:
        """Remove the file."""
        self._disk.shutdown()
        if self._file is not None and self._writing is not None:
            with contextlib.suppress(OSError):
                self._file.unlink()

    def _write(self, file: Path, content: bytes) -> None:
        try:
            write_private(file, content)
        except OSError as error:
            _log.warning("%s: %s; without bifrostd, nodes cannot be found by it", file, error.strerror)


def recall(network: Network) -> list[d.NodeRecord]:
    """The nodes in this computer's file, without processes of this computer that have ended."""
    import psutil  # slow import, needed without a daemon only

    if network.table_cache is None:
        return []
    try:
        table = _decode(network.table_cache.read_bytes())
    except (OSError, msgspec.DecodeError, RecursionError):
        return []
    return [node for node in table.nodes if node.computer != network.computer.name or psutil.pid_exists(node.pid)]
