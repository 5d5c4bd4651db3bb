"""MIP packets on the driver's side: made for commands, and found in whatever bytes a serial line brings.

``valor.devices.mip`` says what stands where.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate
from typing import NamedTuple

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
    """Finds the packets in a stream of bytes, and its way back into step after garbage.

    A candidate whose checksum is wrong costs its first byte alone: a sound packet may have begun inside it.

    Attributes:
        skipped: bytes that were part of no packet.
        wrong_checksums: candidates with a header of which nothing else can be said.
        malformed: packets with a right checksum whose fields do not fill the payload.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.skipped = 0
        self.wrong_checksums = 0
        self.malformed = 0

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Take bytes in; yields the packets that they complete, in order."""
        buffer = self._buffer
        buffer += data
        while True:
            start = buffer.find(SYNC)
            if start < 0:  # the last byte may be half of a SYNC
                start = len(buffer) - (buffer[-1:] == SYNC[:1])
            if start:
                self.skipped += start
                del buffer[:start]
            if len(buffer) < HEADER_SIZE:
                return
            end = HEADER_SIZE + buffer[3]
            if len(buffer) < end + CHECKSUM_SIZE:
                return
            if checksum(buffer[:end]) != buffer[end : end + CHECKSUM_SIZE]:
                self.wrong_checksums += 1
                self.skipped += 1
                del buffer[0]
                continue
            fields = _fields(bytes(buffer[HEADER_SIZE:end]))
            descriptor_set = buffer[2]
            del buffer[: end + CHECKSUM_SIZE]
            if fields is None:
                self.malformed += 1
                continue
            yield Packet(descriptor_set, fields)

    def clear(self) -> None:
        """Forget what is half received."""
        self._buffer.clear()


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
