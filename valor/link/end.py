"""One end of the link, without sockets and clocks of its own: datagrams in, datagrams out, at times that it is told.

There are two channels. The slow one is always on, and what is sent there keeps to a budget of bytes; the fast one is
there in windows, shows it by being heard, and takes what waits. Both carry the same sealed datagrams.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum

from valor.link.budget import Budget, Meter
from valor.link.classes import BY_KIND, HEADERS, Class, Kind, Rates
from valor.link.clocks import OtherClock
from valor.link.errors import SealError
from valor.link.records import FOREVER, Acknowledgement, Message, record, records
from valor.link.reliable import Inbox, Outbox
from valor.link.session import OVERHEAD, SEALED, Session

SILENCE = 2.0  # after which the other end is asked whether it is there [s]
HELLOS = 1.0  # between hellos [s]
ACKNOWLEDGEMENTS = 0.45  # between those that bring nothing but clocks, and the newest state [s]
QUICK = 0.02  # between states on the fast channel [s]
PROBES = 0.1  # between what is sent on the fast channel, to see whether it is there [s]
OPEN = 0.3  # so long after the last word the fast channel counts as there [s]
LARGEST = {0: 140, 1: 1200}  # of a datagram's records, by channel [B]
HELD = 0.2  # so long an acknowledgement waits for company [s]
PATIENCE = 0.5  # of messages that wait for what states leave; then one goes with the next state [s]
AT_ONCE = 16  # datagrams on the fast channel in one turn


class Channel(IntEnum):
    """By which datagrams come and go."""

    SLOW = 0
    FAST = 1


@dataclass(frozen=True)
class Arrived:
    """A message, whole, for the first time.

    Attributes:
        refused: why it must not be obeyed; empty: it is fresh.
    """

    kind: Kind
    id: int
    content: bytes
    refused: str = ""


@dataclass(frozen=True)
class Began:
    """A session: what was under way is lost, and the other end knows nothing of it."""


@dataclass(frozen=True)
class GivenUp:
    """Messages that were not acknowledged before their deadline."""

    ids: frozenset[int]


Event = Arrived | Began | GivenUp


class End:
    """What both ends do alike.

    Attributes:
        other: the other end's clock.
        meter: of what was sent on the slow channel.
        heard_meter: of what came on it.
        refused: datagrams that were not taken, by why.
    """

    def __init__(self, session: Session, rates: Rates, now: float, fast: bool) -> None:
        self._has_fast = fast
        self.session, self._rates, self._born = session, rates, now
        self._budget = Budget(rates, now)
        self.meter, self.fast_meter, self.heard_meter = Meter(), Meter(), Meter()
        self.refused: dict[str, int] = {}
        self._heard = {Channel.SLOW: -1e9, Channel.FAST: -1e9}
        self._hello_due = self._acknowledge_due = now
        self._own_due = {Channel.SLOW: now, Channel.FAST: now}
        self._acknowledged_at = self._went = now
        self._asked: Channel | None = None
        self._events: list[Event] = []
        self._reset()

    def _reset(self) -> None:
        self.other = OtherClock()
        self._outbox, self._inbox = Outbox(), Inbox()
        self._to_acknowledge: set[tuple[int, int]] = set()
        self._echo: tuple[float, float] | None = None  # the other end's clock, and when it came
        self._stream: dict[Kind, bytes] = {}
        self._newest = 0
        self._barrier = 0

    def clock(self, now: float) -> float:
        """This end's [s]."""
        return now - self._born

    def silent(self, now: float) -> float:
        """How long nothing of this session has come [s]."""
        return now - max(self._heard.values())

    def fast(self, now: float) -> bool:
        """Whether the fast channel is there."""
        return now - self._heard[Channel.FAST] < OPEN

    def send(self, kind: Kind, content: bytes, now: float) -> int:
        """Have a message sent until it is acknowledged or its deadline passes; returns its id.

        Raises:
            SealError: the other end has not been heard, so that no deadline can be named; or it is too long.
        """
        lasts = BY_KIND[kind].deadline
        if not self.session.established:
            raise SealError(self.session.strange or "the other end has not been heard yet")
        if kind is Kind.STOP:
            self._give_up(lambda message: message.kind is Kind.COMMAND)
            self._stream.clear()
        deadline = FOREVER if lasts is None else self._deadline(lasts, now)
        return self._outbox.put(kind, content, now, deadline)

    def renew(self, kind: Kind, content: bytes, now: float, before: int = 0) -> int:
        """As ``send``, in place of the message ``before``, which is not sent any more if it has not arrived."""
        self._outbox.give_up(lambda message: message.id == before)
        return self.send(kind, content, now)

    def stream(self, kind: Kind, content: bytes, now: float) -> None:
        """Have the newest of a stream sent; errors as of ``send``."""
        lasts = BY_KIND[kind].deadline or 0.0
        self._stream[kind] = self._deadline(lasts, now).to_bytes(4, "big") + content

    def _give_up(self, which: Callable[[Message], bool]) -> None:
        if gone := self._outbox.give_up(which):
            self._events.append(GivenUp(frozenset(gone)))

    def _deadline(self, lasts: float, now: float) -> int:
        least = self.other.least(now)
        if least < 0.0:
            raise SealError("the other end has not been heard yet")
        return int(1e3 * (least + lasts))

    def receive(self, data: bytes, channel: Channel, now: float) -> bool:
        """A datagram has come; ``events`` has what it says. Whether the other end has sent it; else it is counted."""
        try:
            if data[:1] != bytes((SEALED,)):
                self._hear(data, channel)
                return True
            content, counter = self.session.open(data)
            self._heard[channel] = now
            shares = {"headers": HEADERS + OVERHEAD}
            for kind, body in records(content):
                shares[kind.name.lower()] = shares.get(kind.name.lower(), 0) + len(body)
                self._take(kind, body, counter, now)
            if channel is Channel.SLOW:
                self.heard_meter.count(shares, now)
            return True
        except SealError as error:
            self.refuse(error)
            return False

    def refuse(self, error: SealError) -> None:
        """Count a datagram that is not taken, by why."""
        why = str(error)
        if len(self.refused) < 64 or why in self.refused:
            self.refused[why] = self.refused.get(why, 0) + 1

    def _hear(self, data: bytes, channel: Channel) -> None:
        before = self.session.number
        if self.session.hear(data):
            self._asked = channel
        if self.session.number != before:
            self._reset()
            self._events.append(Began())

    def events(self) -> list[Event]:
        """What has happened since the last call."""
        found, self._events = self._events, []
        return found

    def _take(self, kind: Kind, body: bytes, counter: int, now: float) -> None:
        if kind is Kind.ACKNOWLEDGEMENT:
            self._acknowledged(Acknowledgement.read(body), now)
        elif kind is Kind.STATE:
            self._state_arrived(body, counter, now)
        elif kind is Kind.STREAM:
            if self._fresh(int.from_bytes(body[:4], "big"), now) and counter > self._newest:
                self._newest = counter
                self._events.append(Arrived(kind, 0, body[4:]))
        else:
            self._arrived(Message.read(kind, body), now)

    def _arrived(self, message: Message, now: float) -> None:
        self._to_acknowledge.add((message.id, message.part))
        self._acknowledge_by(now + HELD)
        content = self._inbox.take(message)
        if content is None:
            return
        refused = ""
        if message.kind is Kind.STOP:
            self._barrier = max(self._barrier, message.id)
        elif message.kind is Kind.COMMAND and message.id < self._barrier:
            refused = "a stop was sent after it"
        if not self._fresh(message.deadline, now):
            refused = f"it came {self.clock(now) - message.deadline / 1e3:.1f} s after its deadline"
        self._events.append(Arrived(message.kind, message.id, content, refused))

    def _fresh(self, deadline: int, now: float) -> bool:
        return deadline == FOREVER or 1e3 * self.clock(now) <= deadline

    def _acknowledged(self, told: Acknowledgement, now: float) -> None:
        for each in told.messages:
            self._outbox.acknowledged(*each)
        self.other.arrived(told.clock / 1e3, now)
        if told.echo:
            self.other.answered(told.clock / 1e3, told.echo / 1e3 + self._born, now)
        self._echo = (told.clock / 1e3, now)
        self._state_acknowledged(told.state)

    def _state_acknowledged(self, counter: int) -> None:
        """The other end has the state of this datagram."""

    def _state_arrived(self, data: bytes, counter: int, now: float) -> None:
        """A state has come."""

    def _state(self, counter: int, now: float) -> bytes:
        """The state for the datagram of this counter; empty: there is none to tell."""
        return b""

    def turn(self, now: float) -> list[tuple[Channel, bytes]]:
        """What is to be sent now."""
        sent = list(self._hellos(now))
        if not self.session.established:
            return sent
        least = 1e3 * self.other.least(now)
        self._give_up(lambda message: message.deadline != FOREVER and least > message.deadline)
        for _ in range((AT_ONCE if self.fast(now) else 1) * self._has_fast):
            if not (datagram := self._datagram(Channel.FAST, now)[0]):
                break
            sent.append((Channel.FAST, datagram))
        while True:
            datagram, urgent = self._datagram(Channel.SLOW, now)
            if not datagram:
                return sent
            sent.append((Channel.SLOW, datagram))
            if urgent and self.fast(now):  # the same one: whichever comes first
                sent.append((Channel.FAST, datagram))

    def _hellos(self, now: float) -> Iterator[tuple[Channel, bytes]]:
        if self._asked is not None:
            yield self._asked, self._counted_hello(False, now)
            self._asked = None
        quiet = not self.session.established or self.silent(now) > SILENCE
        if quiet and now >= self._hello_due:
            self._hello_due = now + HELLOS
            yield Channel.SLOW, self._counted_hello(True, now)

    def _counted_hello(self, asks: bool, now: float) -> bytes:
        data = self.session.hello(asks)
        self._budget.spend(len(data), now)
        self.meter.count({"hello": len(data) + HEADERS}, now)
        return data

    def _datagram(self, channel: Channel, now: float) -> tuple[bytes, bool]:
        """The next one on a channel, and whether it is urgent; empty: there is none, or it would cost too much."""
        slow = channel is Channel.SLOW
        left = self._budget.left(now) if slow else math.inf
        due = self._outbox.due(now) if slow or self.fast(now) else []
        regular = left > 0.0 and now >= self._own_due[channel]
        own = self._own(channel, now, regular, bool(due) and self._rates.slowest is None) if left > 0.0 else []
        room = LARGEST[channel] - _size(own) * (not slow)
        spare = self._spare(left, own, regular) if slow else math.inf
        taken: list[tuple[Class, bytes]] = []
        for message in due:
            each, made = BY_KIND[message.kind], message.record()
            fits = len(made) <= spare or (regular and not taken and now - self._went > PATIENCE)
            if len(made) > room or not (fits or each.indebted) or (not slow and each.indebted):
                continue
            taken.append((each, made))
            room, spare = room - len(made), spare - len(made)
            self._outbox.sent(message, now)
        if slow and (taken or not due):
            self._went = now
        if regular:
            self._regular_again(channel, now, waits=len(taken) < len(due))
        if not (parts := taken + own):
            return b"", False
        datagram = self.session.seal(b"".join(made for _, made in parts))
        self._account(parts, len(datagram), slow, now)
        return datagram, any(each.indebted for each, _ in taken)

    def _spare(self, left: float, own: list[tuple[Class, bytes]], regular: bool) -> float:
        """What messages may take of the slow channel now, so that the next state is in time [B]."""
        if left <= 0.0:
            return 0.0
        if self._rates.slowest is None:
            return math.inf
        if not regular:
            return 0.0
        return left - _size(own) - HEADERS - OVERHEAD + self._rates.budget * self._rates.slowest

    def _regular_again(self, channel: Channel, now: float, waits: bool) -> None:
        """When this end speaks by itself next; ``waits``: something has found no place."""
        if channel is Channel.FAST:
            period = QUICK if self.fast(now) else PROBES
        else:
            period = self._rates.slowest if waits and self._rates.slowest is not None else self._rates.period
        self._own_due[channel] = max(self._own_due[channel] + period, now)

    def _own(self, channel: Channel, now: float, regular: bool, company: bool) -> list[tuple[Class, bytes]]:
        """What this end says by itself: acknowledgements, streams, the state; ``company``: messages are to go."""
        parts = []
        there = channel is Channel.SLOW or self.fast(now)
        waits = bool(self._to_acknowledge) and there and (regular or company or channel is Channel.FAST)
        probe = regular and channel is Channel.FAST
        if probe or waits or (regular and now >= self._acknowledge_due):
            if channel is Channel.SLOW:
                self._acknowledge_due = now + ACKNOWLEDGEMENTS
            parts.append((BY_KIND[Kind.ACKNOWLEDGEMENT], self._acknowledgement(now, there)))
        if there:
            parts += [(BY_KIND[kind], record(kind, body)) for kind, body in self._stream.items()]
            self._stream.clear()
        if regular and there and (state := self._state(self.session.next_counter, now)):
            parts.append((BY_KIND[Kind.STATE], record(Kind.STATE, state)))
        return parts

    def _acknowledge_by(self, at: float) -> None:
        """Have what has come acknowledged at that time, at the latest."""
        self._own_due[Channel.SLOW] = min(self._own_due[Channel.SLOW], at)
        self._acknowledge_due = min(self._acknowledge_due, at)

    def _acknowledgement(self, now: float, there: bool) -> bytes:
        echo = 0 if self._echo is None else round(1e3 * (self._echo[0] + now - self._echo[1]))
        told = sorted(self._to_acknowledge)[: 40 * there]
        self._to_acknowledge.difference_update(told)
        clock = round(1e3 * self.clock(now))
        self._acknowledged_at = now
        return Acknowledgement(self._newest, clock, echo, tuple(told)).record()

    def _account(self, parts: list[tuple[Class, bytes]], size: int, slow: bool, now: float) -> None:
        shares: dict[str, int] = {}
        for each, made in parts:
            shares[each.kind.name.lower()] = shares.get(each.kind.name.lower(), 0) + len(made)
        shares["headers"] = HEADERS + OVERHEAD
        (self.meter if slow else self.fast_meter).count(shares, now)
        if slow:
            self._budget.spend(size, now)


def _size(parts: list[tuple[Class, bytes]]) -> int:
    return sum(len(made) for _, made in parts)
