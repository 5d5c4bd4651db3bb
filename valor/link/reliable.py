"""Messages that arrive once or not at all: sent again until acknowledged or too late, taken once, in whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from valor.link.classes import BY_KIND, Kind
from valor.link.errors import SealError
from valor.link.records import FOREVER, Message, parted

BEHIND = 4096  # ids behind the highest that are remembered; what is older has been here before
UNFINISHED = 64  # messages of which parts are kept


_ORDER = list(BY_KIND)


@dataclass
class _Waiting:
    """A part that is not acknowledged yet."""

    message: Message
    due: float
    interval: float


class Outbox:
    """What one end has to say."""

    def __init__(self) -> None:
        self._waiting: dict[tuple[int, int], _Waiting] = {}
        self._next = 1

    def put(self, kind: Kind, content: bytes, now: float, deadline: int = FOREVER) -> int:
        """Have it sent; returns its id.

        Raises:
            SealError: it is too long, or too many of its class wait.
        """
        self._make_room(kind)
        number = self._next
        for part in parted(kind, number, deadline, content):
            self._waiting[number, part.part] = _Waiting(part, now, BY_KIND[kind].again)
        self._next += 1
        return number

    def _make_room(self, kind: Kind) -> None:
        each = BY_KIND[kind]
        waiting = sorted({one.message.id for one in self._waiting.values() if one.message.kind is kind})
        if len(waiting) < each.most:
            return
        if each.deadline is not None:
            raise SealError(f"{kind.name}: {len(waiting)} wait to be acknowledged; expected fewer than {each.most}")
        self.give_up(lambda message: message.id == waiting[0])

    def due(self, now: float) -> list[Message]:
        """Parts to send now, the most urgent class first."""
        found = [each.message for each in self._waiting.values() if each.due <= now]
        return sorted(found, key=lambda each: (_ORDER.index(each.kind), each.id, each.part))

    def sent(self, message: Message, now: float) -> None:
        """It is on its way; later it is due again."""
        waiting = self._waiting.get((message.id, message.part))
        if waiting is not None:
            waiting.due = now + waiting.interval
            waiting.interval = min(2.0 * waiting.interval, 8.0)

    def acknowledged(self, number: int, part: int) -> None:
        """It has arrived."""
        self._waiting.pop((number, part), None)

    def give_up(self, late: Callable[[Message], bool]) -> set[int]:
        """Let go of what is late; returns the ids."""
        gone = {each.message.id for each in self._waiting.values() if late(each.message)}
        self._waiting = {key: each for key, each in self._waiting.items() if key[0] not in gone}
        return gone

    def waits(self, number: int) -> bool:
        """Whether any part of a message has not been acknowledged."""
        return any(key[0] == number for key in self._waiting)


class Inbox:
    """What one end is told: each message once."""

    def __init__(self) -> None:
        self._done: set[int] = set()
        self._highest = 0
        self._parts: dict[int, dict[int, Message]] = {}

    def take(self, message: Message) -> bytes | None:
        """The content, when its last part has come, for the first time; else None."""
        number = message.id
        if number in self._done or number <= self._highest - BEHIND:
            return None
        parts = self._parts.setdefault(number, {})
        parts[message.part] = message
        if len(parts) < message.parts:
            while len(self._parts) > UNFINISHED:
                del self._parts[min(self._parts)]
            return None
        del self._parts[number]
        self._done.add(number)
        self._highest = max(self._highest, number)
        if len(self._done) > 2 * BEHIND:
            self._done = {each for each in self._done if each > self._highest - BEHIND}
        return b"".join(parts[part].content for part in sorted(parts))
