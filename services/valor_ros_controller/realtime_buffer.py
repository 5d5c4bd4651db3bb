"""The two-slot buffer that carries the newest value from one thread to another (thesis section 3.5, figure 3.10)."""

from __future__ import annotations

from typing import Generic, TypeVar

T = TypeVar("T")


class RealTimeBuffer(Generic[T]):
    """Newest value from one writing thread to one reading thread; neither ever waits for the other.

    ::

        (A) write("c"): into the slot that is not read,      (B) then the indices change places:
            in front of nobody's eyes                            "c" is what a reader finds

             write ─► ┌───────────┐                             read ──► ┌───────────┐
                      │ 3 │  "c"  │                                      │ 3 │  "c"  │
                      ├───────────┤                                      ├───────────┤
             read ──► │ 2 │  "b"  │                             write ─► │ 2 │  "b"  │
                      └───────────┘                                      └───────────┘

    A slot is one reference to a (count, value) pair, so a reader finds a whole pair, the old or the new. Older
    values are lost, which is the point: for what must not be lost use a queue. The value is handed over, not copied:
    the writer does not touch it afterwards.
    """

    __slots__ = ("_read", "_seen", "_slots")

    def __init__(self) -> None:
        self._slots: list[tuple[int, T | None]] = [(0, None), (0, None)]
        self._read = 0
        self._seen = 0

    def write(self, value: T) -> None:
        """Make ``value`` the newest."""
        write = 1 - self._read
        self._slots[write] = (self._slots[self._read][0] + 1, value)
        self._read = write

    def read(self) -> T | None:
        """The newest value if it was not read before, else ``None``."""
        count, value = self._slots[self._read]
        if count <= self._seen:
            return None
        self._seen = count
        return value

    @property
    def newest(self) -> T | None:
        """The newest value, read before or not; ``None`` before the first."""
        return self._slots[self._read][1]
