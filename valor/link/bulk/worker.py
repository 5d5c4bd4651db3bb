"""What takes as long as a disk does, beside the loop: one piece of work after the other."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from valor.link.bulk.sinks import Sink
from valor.link.bulk.wire import Described
from valor.link.errors import BulkError

Work = tuple[Described, Sink]


class Worker:
    """Used from the loop's thread."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="bulk")
        self._under_way: list[tuple[Work, Future[bytes]]] = []

    def do(self, what: Work, how: Callable[[], bytes]) -> None:
        """Begin, when all before is done."""
        self._under_way.append((what, self._pool.submit(how)))

    def has(self, described: Described) -> bool:
        """Whether a thing is being worked on."""
        return any(each.digest == described.digest for (each, _), _ in self._under_way)

    def done(self) -> list[tuple[Work, bytes, str | None]]:
        """What has ended since the last call: its content, or why it failed."""
        found: list[tuple[Work, bytes, str | None]] = []
        while self._under_way and self._under_way[0][1].done():
            work, future = self._under_way.pop(0)
            try:
                found.append((work, future.result(), None))
            except BulkError as error:
                found.append((work, b"", str(error)))
        return found

    def close(self) -> None:
        """When all is done that was begun."""
        self._pool.shutdown()
