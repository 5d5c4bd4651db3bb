"""MIP packets on the driver's side: made for commands, and found in whatever bytes a serial line brings.

``valor.devices.mip`` says what stands where.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate
from typing import NamedTuple

from valor.devices.frame_stream import FrameStream
from valor.devices.mip import CHECKSUM_SIZE, HEADER_SIZE, MAX_PAYLOAD, SYNC

Field = tuple[int, bytes]
"""Descriptor and data."""


class Packet(NamedTuple):
    """A sound packet."""

    descriptor_set: int
    fields: tuple[Field, ...]


def checksum(data: bytes | bytearray) -> bytes:
    """Fletcher's, over header and payload."""
    return bytes((sum(data) & 0xFF, sum(accumulate(data)) & 0xFF))


def encode(descriptor_set: int, fields: Sequence[Field]) -> bytes:
    """A packet's bytes.

    Raises:
        ValueError: the fields do not fit into one packet.
    """
    payload = b"".join(bytes((len(data) + 2, descriptor)) + data for descriptor, data in fields)
    if len(payload) > MAX_PAYLOAD:
        raise ValueError(f"payload of {len(payload)} bytes: a packet holds {MAX_PAYLOAD}")
    frame = SYNC + bytes((descriptor_set, len(payload))) + payload
    return frame + checksum(frame)


class PacketStream:
    """Finds the packets in a stream of bytes.

    Attributes:
        malformed: packets with a right checksum whose fields do not fill the payload.
    """

    def __init__(self) -> None:
        self._frames = FrameStream(SYNC, HEADER_SIZE, _size, _is_sound)
        self.malformed = 0

    @property
    def skipped(self) -> int:
        """Bytes that were part of no packet."""
        return self._frames.skipped

    @property
    def wrong_checksums(self) -> int:
        """Candidates with a header of which nothing else can be said."""
        return self._frames.unsound

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Take bytes in; yields the packets that they complete, in order."""
        for frame in self._frames.feed(data):
            fields = _fields(frame[HEADER_SIZE:-CHECKSUM_SIZE])
            if fields is None:
                self.malformed += 1
            else:
                yield Packet(frame[2], fields)

    def clear(self) -> None:
        """Forget what is half received."""
        self._frames.clear()


def _size(header: bytearray) -> int:
    return HEADER_SIZE + header[3] + CHECKSUM_SIZE


def _is_sound(frame: bytes) -> bool:
    return checksum(frame[:-CHECKSUM_SIZE]) == frame[-CHECKSUM_SIZE:]


def _fields(payload: bytes) -> tuple[Field, ...] | None:
    """A payload's fields; None if they do not fill it."""
    fields = []
    place = 0
    while place < len(payload):
        length = payload[place]
        if length < 2 or place + length > len(payload):
            return None
        fields.append((payload[place + 1], payload[place + 2 : place + length]))
        place += length
    return tuple(fields)
