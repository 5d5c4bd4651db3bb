"""Extracts frames from a stream of bytes of a serial line, also after invalid bytes."""

from collections.abc import Callable, Iterator


class FrameStream:
    """Extracts the frames of one protocol from a stream; a valid frame may start inside an invalid candidate."""

    def __init__(
        self, header: bytes, prefix: int, size: Callable[[bytearray], int], is_valid: Callable[[bytes], bool]
    ) -> None:
        """``size`` of a frame follows from its first ``prefix`` bytes, with header and checksum [B]; 0 if invalid."""
        self._header, self._prefix, self._size, self._is_valid = header, prefix, size, is_valid
        self._buffer = bytearray()
        self.skipped = 0  # bytes that were part of no frame
        self.invalid = 0  # number of invalid candidates with a valid header

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Add bytes; yields the completed frames, in order."""
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
            if not size or not self._is_valid(frame):
                self.invalid += 1
                self._skip(1)
                continue
            del buffer[:size]
            yield frame

    def clear(self) -> None:
        """Discard partial frames."""
        self._buffer.clear()

    def _start(self) -> int:
        """Position where the next frame may start; the end of the buffer may hold a partial header."""
        buffer, header = self._buffer, self._header
        if (start := buffer.find(header)) >= 0:
            return start
        rest = next(n for n in range(len(header) - 1, -1, -1) if buffer.endswith(header[:n]))
        return len(buffer) - rest

    def _skip(self, count: int) -> None:
        if count:
            self.skipped += count
            del self._buffer[:count]
