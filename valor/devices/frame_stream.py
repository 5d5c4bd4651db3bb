"""Frames in a stream of bytes, as serial lines bring them: found wherever they begin, and found again after garbage."""

from __future__ import annotations

from collections.abc import Callable, Iterator


class FrameStream:
    """Cuts the frames of one protocol out of a stream.

    A candidate that is not sound costs its first byte alone: a sound frame may have begun inside it.

    Attributes:
        skipped: bytes that were part of no frame.
        unsound: candidates with the header of one of which nothing else can be said.
    """

    def __init__(
        self, header: bytes, prefix: int, size: Callable[[bytearray], int], is_sound: Callable[[bytes], bool]
    ) -> None:
        """What the protocol's frames look like.

        Args:
            header: with which each begins.
            prefix: how many bytes ``size`` needs [B].
            size: of the frame that begins so, with header and checksum [B]; 0: none begins so.
            is_sound: whether a whole frame has the checksum that belongs to it.
        """
        self._header, self._prefix, self._size, self._is_sound = header, prefix, size, is_sound
        self._buffer = bytearray()
        self.skipped = 0
        self.unsound = 0

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Take bytes in; yields the frames that they complete, in order."""
        buffer = self._buffer
        buffer += data
        while True:
            self._skip(self._start())
            if len(buffer) < self._prefix:
                return
            size = self._size(buffer)
            if size and len(buffer) < size:
                return
            frame = bytes(buffer[:size])
            if not size or not self._is_sound(frame):
                self.unsound += 1
                self._skip(1)
                continue
            del buffer[:size]
            yield frame

    def clear(self) -> None:
        """Forget what is half received."""
        self._buffer.clear()

    def _start(self) -> int:
        """Where the next frame may begin; what is left at the end may be the beginning of a header."""
        buffer, header = self._buffer, self._header
        if (start := buffer.find(header)) >= 0:
            return start
        rest = next(n for n in range(len(header) - 1, -1, -1) if buffer.endswith(header[:n]))
        return len(buffer) - rest

    def _skip(self, count: int) -> None:
        if count:
            self.skipped += count
            del self._buffer[:count]
