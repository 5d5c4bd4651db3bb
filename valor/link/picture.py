"""Transfer of the latest camera picture over the fast channel: chunks of one picture, a newer one replaces it.

The robot's end repeats all chunks until the operator's end acknowledges the picture, at most ``ROUNDS`` times. Body of
a ``PICTURE`` record: from the robot number (4), index (2) and count (2) of the chunk, then its bytes; from the operator
the number of a complete picture (4).
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

from valor.link.errors import SealError

CHUNK = 1150  # [B]
LARGEST = 2**20  # picture that is sent [B]
PERIOD = 0.01  # between two batches [s]
BATCH = 8  # chunks; more would push delayed datagrams out of the session's window of counters
PAUSE = 0.05  # after all chunks, for the acknowledgement [s]
ROUNDS = 3
INTERVAL = 0.5  # between the starts of two pictures [s]
_CHUNK = struct.Struct(">IHH")
_NUMBER = struct.Struct(">I")
_PICTURE = struct.Struct(">QBB")  # clock, lengths of format and frame


@dataclass(frozen=True)
class Picture:
    """A compressed picture."""

    clock: int  # robot end's clock when it was taken [ms]
    form: str  # ``format`` of ``sensor_msgs/CompressedImage``
    frame: str  # of the camera
    content: bytes

    def encode(self) -> bytes:
        """Bytes for the link."""
        form, frame = self.form.encode()[:255], self.frame.encode()[:255]
        return _PICTURE.pack(self.clock, len(form), len(frame)) + form + frame + self.content

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Inverse of ``encode``. Raises SealError: too short."""
        if len(data) < _PICTURE.size:
            raise SealError(f"PICTURE: {len(data)} bytes; expected at least {_PICTURE.size}")
        clock, form, frame = _PICTURE.unpack_from(data)
        frame_at = _PICTURE.size + form
        content_at = frame_at + frame
        texts = data[_PICTURE.size : frame_at], data[frame_at:content_at]
        return cls(clock, texts[0].decode(errors="replace"), texts[1].decode(errors="replace"), data[content_at:])


class PictureSender:
    """Chunks of the latest picture, on the robot's end."""

    def __init__(self, latest: Callable[[], Picture | None]) -> None:
        """``latest``: the newest picture; None if there is none."""
        self._latest = latest
        self._picture: Picture | None = None
        self._chunks: list[bytes] = []
        self._number = self._next = 0
        self._due = self._replace_at = 0.0
        self.restart()

    def restart(self) -> None:
        """Abandon the current picture: the fast channel was closed."""
        self._rounds, self._next = ROUNDS, len(self._chunks)

    def acknowledged(self, body: bytes) -> None:
        """Process the acknowledgement of a complete picture."""
        if body == _NUMBER.pack(self._number):
            self.restart()

    def turn(self, now: float) -> list[bytes]:
        """Bodies to send at the monotonic time ``now`` [s]."""
        if now < self._due:
            return []
        self._due = now + PERIOD
        if self._next >= len(self._chunks) and not self._next_round(now):
            return []
        batch = self._chunks[self._next : self._next + BATCH]
        self._next += len(batch)
        if self._next >= len(self._chunks):
            self._rounds += 1
            self._due = now + PAUSE
        return batch

    def _next_round(self, now: float) -> bool:
        """Start another round of this picture, or a newer one; False if there is nothing to send."""
        if self._rounds >= ROUNDS:
            picture = self._latest() if now >= self._replace_at else None
            if picture is None or picture is self._picture:
                return False
            self._picture, self._rounds = picture, 0
            self._replace_at = now + INTERVAL
            self._split(picture.encode())
        self._next = 0
        return bool(self._chunks)

    def _split(self, data: bytes) -> None:
        pieces = [data[at : at + CHUNK] for at in range(0, len(data), CHUNK)] if len(data) <= LARGEST else []
        self._number += 1
        self._chunks = [_CHUNK.pack(self._number, index, len(pieces)) + piece for index, piece in enumerate(pieces)]


class PictureReceiver:
    """Collects the chunks of one picture, on the operator's end."""

    def __init__(self) -> None:
        self._number = 0
        self._chunks: dict[int, bytes] = {}
        self._complete = self._acknowledge = False

    def take(self, body: bytes) -> Picture | None:
        """Process a chunk; returns the picture when it is complete. Raises SealError: malformed."""
        if len(body) < _CHUNK.size:
            raise SealError(f"PICTURE: {len(body)} bytes; expected at least {_CHUNK.size}")
        number, index, count = _CHUNK.unpack_from(body)
        if not index < count:
            raise SealError(f"PICTURE: chunk {index} of {count}")
        if number > self._number:
            self._number, self._chunks, self._complete = number, {}, False
        if number < self._number:
            return None
        self._acknowledge = self._complete
        if self._complete:
            return None
        self._chunks[index] = body[_CHUNK.size :]
        if len(self._chunks) < count:
            return None
        self._complete = self._acknowledge = True
        return Picture.decode(b"".join(self._chunks[each] for each in range(count)))

    def acknowledgement(self) -> bytes:
        """Body to send now; empty if none is due."""
        due, self._acknowledge = self._acknowledge, False
        return _NUMBER.pack(self._number) if due else b""
