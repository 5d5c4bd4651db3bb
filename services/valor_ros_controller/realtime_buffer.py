"""Two-slot buffer for the latest value between two threads (thesis section 3.5, figure 3.10)."""

from typing import Generic, TypeVar

T = TypeVar("T")


class RealTimeBuffer(Generic[T]):
    """Latest value from one writing thread to one reading thread; neither waits for the other.

    A value is written into the slot that is not read; then the indices are swapped. A slot is one reference to a
    (count, value) pair, so a reader finds a consistent pair. Older values are lost; use a queue for values that must
    not be. The value is not copied: the writer does not change it afterwards.
    """

    __slots__ = ("_read", "_seen", "_slots")

    def __init__(self) -> None:
        self._slots: list[tuple[int, T | None]] = [(0, None), (0, None)]
        self._read = 0
        self._seen = 0

    def write(self, value: T) -> None:
        """Store ``value`` as the latest."""
        write = 1 - self._read
        self._slots[write] = (self._slots[self._read][0] + 1, value)
        self._read = write

    def read(self) -> T | None:
        """Latest value if it was not read before, else ``None``."""
        count, value = self._slots[self._read]
        if count <= self._seen:
            return None
        self._seen = count
        return value
