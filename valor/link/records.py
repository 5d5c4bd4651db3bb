"""Records, of which several travel in one datagram, and what is in them.

A record is its kind (1), the length of its body (1, or 255 and 2) and the body. Of what must arrive the body is id (4),
part (1), parts (1), deadline where the class has one (4: the robot end's clock [ms]), then a part of the content.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from valor.link.classes import BY_KIND, Kind
from valor.link.errors import SealError

_LENGTH = struct.Struct(">H")
_MESSAGE = struct.Struct(">IBB")
_DEADLINE = struct.Struct(">I")
_LONG = 255
FOREVER = 2**32 - 1


@dataclass(frozen=True)
class Message:
    """What must arrive, or a part of it.

    Attributes:
        deadline: by the robot end's clock [ms]; ``FOREVER`` where there is none.
    """

    kind: Kind
    id: int
    part: int
    parts: int
    deadline: int
    content: bytes

    def record(self) -> bytes:
        """As it travels."""
        deadline = _DEADLINE.pack(self.deadline) if BY_KIND[self.kind].deadline is not None else b""
        return record(self.kind, _MESSAGE.pack(self.id, self.part, self.parts) + deadline + self.content)

    @classmethod
    def read(cls, kind: Kind, body: bytes) -> Message:
        """The inverse of ``record``.

        Raises:
            SealError: the body is too short.
        """
        dated = BY_KIND[kind].deadline is not None
        size = _MESSAGE.size + (_DEADLINE.size if dated else 0)
        if len(body) < size:
            raise SealError(f"{kind.name}: {len(body)} bytes; expected at least {size}")
        number, part, parts = _MESSAGE.unpack_from(body)
        deadline = _DEADLINE.unpack_from(body, _MESSAGE.size)[0] if dated else FOREVER
        if not part < parts:
            raise SealError(f"{kind.name}: part {part} of {parts}")
        return cls(kind, number, part, parts, deadline, body[size:])


def parted(kind: Kind, number: int, deadline: int, content: bytes) -> list[Message]:
    """A message in parts that each fit beside a state.

    Raises:
        SealError: it is longer than 255 parts.
    """
    size = BY_KIND[kind].part
    pieces = [content[at : at + size] for at in range(0, len(content), size)] or [b""]
    if len(pieces) > _LONG:
        raise SealError(f"{kind.name}: {len(content)} bytes; expected at most {_LONG * size}")
    return [Message(kind, number, part, len(pieces), deadline, piece) for part, piece in enumerate(pieces)]


def record(kind: Kind, body: bytes) -> bytes:
    """One record."""
    size = bytes((len(body),)) if len(body) < _LONG else bytes((_LONG,)) + _LENGTH.pack(len(body))
    return bytes((kind,)) + size + body


def records(data: bytes) -> Iterator[tuple[Kind, bytes]]:
    """Those of a datagram.

    Raises:
        SealError: they do not end where the datagram does, or one is of no known kind.
    """
    at = 0
    while at < len(data):
        try:
            kind, size, at = Kind(data[at]), data[at + 1], at + 2
            if size == _LONG:
                size, at = _LENGTH.unpack_from(data, at)[0], at + 2
        except (ValueError, IndexError, struct.error):
            raise SealError(f"byte {at}: expected a record") from None
        if at + size > len(data):
            raise SealError(f"byte {at}: a record of {size} bytes goes beyond the end")
        yield kind, data[at : at + size]
        at += size


_ACK = struct.Struct(">III")


@dataclass(frozen=True)
class Acknowledgement:
    """What one end has of the other's.

    Attributes:
        state: counter of the newest state that arrived; 0: none.
        clock: of the sender, when it sent this [ms].
        echo: the newest clock of the other end's that came, and how long ago that was, added up [ms]; 0: none.
        messages: ids and parts.
    """

    state: int
    clock: int
    echo: int
    messages: tuple[tuple[int, int], ...] = ()

    def record(self) -> bytes:
        """As it travels."""
        told = b"".join(struct.pack(">IB", *each) for each in self.messages)
        return record(Kind.ACKNOWLEDGEMENT, _ACK.pack(self.state, self.clock, self.echo) + told)

    @classmethod
    def read(cls, body: bytes) -> Acknowledgement:
        """The inverse of ``record``.

        Raises:
            SealError: it is none.
        """
        if len(body) < _ACK.size or (len(body) - _ACK.size) % 5:
            raise SealError(f"ACKNOWLEDGEMENT: {len(body)} bytes")
        messages = tuple((number, part) for number, part in struct.iter_unpack(">IB", body[_ACK.size :]))
        state, clock, echo = _ACK.unpack_from(body)
        return cls(state, clock, echo, messages)
