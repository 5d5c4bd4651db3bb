"""Records, several of which share one datagram, and reliable messages: repeated until acknowledged, delivered once.

A record is its class (1), the length of its body (1, or 255 and 2) and the body. The body of a reliable message is id
(4), part (1), parts (1), deadline if the class has one (4: robot end's clock [ms]), then a part of the content.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Self

from valor.link.classes import BY_CLASS, MessageClass
from valor.link.errors import SealError

_LENGTH = struct.Struct(">H")
_MESSAGE = struct.Struct(">IBB")
_DEADLINE = struct.Struct(">I")
_ACKNOWLEDGEMENT = struct.Struct(">III")
_ACKNOWLEDGED = struct.Struct(">IB")
_LONG = 255
NO_DEADLINE = 2**32 - 1
REMEMBERED_IDS = 4096  # behind the highest; older ones count as delivered
INCOMPLETE_MESSAGES = 64  # whose parts are stored
LONGEST_INTERVAL = 8.0  # between repetitions [s]
_PRIORITY = {kind: number for number, kind in enumerate(BY_CLASS)}


@dataclass(frozen=True)
class Message:
    """A part of a reliable message."""

    kind: MessageClass
    id: int
    part: int
    parts: int
    deadline: int  # by the robot end's clock [ms]; ``NO_DEADLINE``: none
    content: bytes

    def record(self) -> bytes:
        """Record for a datagram."""
        deadline = _DEADLINE.pack(self.deadline) if BY_CLASS[self.kind].deadline is not None else b""
        return record(self.kind, _MESSAGE.pack(self.id, self.part, self.parts) + deadline + self.content)

    @classmethod
    def read(cls, kind: MessageClass, body: bytes) -> Self:
        """Inverse of ``record``. Raises SealError: malformed."""
        dated = BY_CLASS[kind].deadline is not None
        size = _MESSAGE.size + (_DEADLINE.size if dated else 0)
        if len(body) < size:
            raise SealError(f"{kind.name}: {len(body)} bytes; expected at least {size}")
        number, part, parts = _MESSAGE.unpack_from(body)
        deadline = _DEADLINE.unpack_from(body, _MESSAGE.size)[0] if dated else NO_DEADLINE
        if not part < parts:
            raise SealError(f"{kind.name}: part {part} of {parts}")
        return cls(kind, number, part, parts, deadline, body[size:])


def split(kind: MessageClass, number: int, deadline: int, content: bytes) -> list[Message]:
    """Parts of a message. Raises SealError: longer than 255 parts."""
    size = BY_CLASS[kind].part_size
    pieces = [content[at : at + size] for at in range(0, len(content), size)] or [b""]
    if len(pieces) > _LONG:
        raise SealError(f"{kind.name}: {len(content)} bytes; expected at most {_LONG * size}")
    return [Message(kind, number, part, len(pieces), deadline, piece) for part, piece in enumerate(pieces)]


def record(kind: MessageClass, body: bytes) -> bytes:
    """One record."""
    size = bytes((len(body),)) if len(body) < _LONG else bytes((_LONG,)) + _LENGTH.pack(len(body))
    return bytes((kind,)) + size + body


def records(data: bytes) -> Iterator[tuple[MessageClass, bytes]]:
    """Records of a datagram. Raises SealError: an unknown class, or a record that exceeds the datagram."""
    at = 0
    while at < len(data):
        try:
            kind, size, at = MessageClass(data[at]), data[at + 1], at + 2
            if size == _LONG:
                size, at = _LENGTH.unpack_from(data, at)[0], at + 2
        except (ValueError, IndexError, struct.error):
            raise SealError(f"byte {at}: expected a record") from None
        if at + size > len(data):
            raise SealError(f"byte {at}: a record of {size} bytes exceeds the datagram")
        yield kind, data[at : at + size]
        at += size


@dataclass(frozen=True)
class Acknowledgement:
    """What one end has received."""

    state: int  # counter of the latest state; 0: none
    clock: int  # of the sender, when it sent this [ms]
    echo: int  # latest clock received from the other end, plus the time since then [ms]; 0: none
    messages: tuple[tuple[int, int], ...] = ()  # ids and parts

    def record(self) -> bytes:
        """Record for a datagram."""
        messages = b"".join(_ACKNOWLEDGED.pack(*each) for each in self.messages)
        return record(MessageClass.ACKNOWLEDGEMENT, _ACKNOWLEDGEMENT.pack(self.state, self.clock, self.echo) + messages)

    @classmethod
    def read(cls, body: bytes) -> Self:
        """Inverse of ``record``. Raises SealError: malformed."""
        first = _ACKNOWLEDGEMENT.size
        if len(body) < first or (len(body) - first) % _ACKNOWLEDGED.size:
            raise SealError(f"ACKNOWLEDGEMENT: {len(body)} bytes")
        messages = tuple((number, part) for number, part in _ACKNOWLEDGED.iter_unpack(body[first:]))
        state, clock, echo = _ACKNOWLEDGEMENT.unpack_from(body)
        return cls(state, clock, echo, messages)


@dataclass
class _Waiting:
    """A part that is not acknowledged."""

    message: Message
    due: float
    interval: float


class Outbox:
    """Outgoing reliable messages, retransmitted until acknowledged or abandoned."""

    def __init__(self) -> None:
        self._waiting: dict[tuple[int, int], _Waiting] = {}
        self._next = 1

    def put(self, kind: MessageClass, content: bytes, now: float, deadline: int = NO_DEADLINE) -> int:
        """Queue a message; returns its id. Raises SealError: too long, or too many messages of its class wait."""
        self._make_room(kind)
        number = self._next
        for part in split(kind, number, deadline, content):
            self._waiting[number, part.part] = _Waiting(part, now, BY_CLASS[kind].retry_after)
        self._next += 1
        return number

    def _make_room(self, kind: MessageClass) -> None:
        each = BY_CLASS[kind]
        waiting = sorted({one.message.id for one in self._waiting.values() if one.message.kind is kind})
        if len(waiting) < each.capacity:
            return
        if each.deadline is not None:
            raise SealError(f"{kind.name}: {len(waiting)} not acknowledged; expected less than {each.capacity}")
        self.abandon(lambda message: message.id == waiting[0])

    def due(self, now: float) -> list[Message]:
        """Parts to send now, the most urgent class first."""
        found = [each.message for each in self._waiting.values() if each.due <= now]
        return sorted(found, key=lambda each: (_PRIORITY[each.kind], each.id, each.part))

    def sent(self, message: Message, now: float) -> None:
        """Schedule the next repetition of a part that was sent."""
        waiting = self._waiting.get((message.id, message.part))
        if waiting is not None:
            waiting.due = now + waiting.interval
            waiting.interval = min(2.0 * waiting.interval, LONGEST_INTERVAL)

    def acknowledged(self, number: int, part: int) -> None:
        """Remove a part that the other end has received."""
        self._waiting.pop((number, part), None)

    def abandon(self, which: Callable[[Message], bool]) -> set[int]:
        """Remove messages of which a waiting part satisfies ``which``; returns their ids."""
        removed = {each.message.id for each in self._waiting.values() if which(each.message)}
        self._waiting = {key: each for key, each in self._waiting.items() if key[0] not in removed}
        return removed


class Inbox:
    """Incoming reliable messages, each delivered once."""

    def __init__(self) -> None:
        self._delivered: set[int] = set()
        self._highest = 0
        self._parts: dict[int, dict[int, Message]] = {}

    def take(self, message: Message) -> bytes | None:
        """Content of a message when its last part arrives for the first time; else None."""
        number = message.id
        if number in self._delivered or number <= self._highest - REMEMBERED_IDS:
            return None
        parts = self._parts.setdefault(number, {})
        parts[message.part] = message
        if len(parts) < message.parts:
            while len(self._parts) > INCOMPLETE_MESSAGES:
                del self._parts[min(self._parts)]
            return None
        del self._parts[number]
        self._delivered.add(number)
        self._highest = max(self._highest, number)
        if len(self._delivered) > 2 * REMEMBERED_IDS:
            self._delivered = {each for each in self._delivered if each > self._highest - REMEMBERED_IDS}
        return b"".join(parts[part].content for part in sorted(parts))
