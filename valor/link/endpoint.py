"""Link endpoint without I/O: the caller supplies datagrams and time, and sends the datagrams returned.

The slow channel is always open, and its datagrams keep to a byte budget. The fast channel is open in windows: it counts
as open while datagrams arrive on it, and then carries what waits. Both carry the same sealed datagrams.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum

from valor.link.classes import BY_CLASS, HEADERS, Budget, MessageClass, Meter, Rates, TrafficClass
from valor.link.errors import SealError
from valor.link.other_clock import OtherClock
from valor.link.records import NO_DEADLINE, Acknowledgement, Inbox, Message, Outbox, record, records
from valor.link.session import OVERHEAD, SEALED, Session

SILENCE = 2.0  # without datagrams, until hellos are sent [s]
HELLO_PERIOD = 1.0  # [s]
REPLY_PERIOD = 0.5  # at least between replies to hellos, whose bytes states need [s]
ACKNOWLEDGEMENT_PERIOD = 0.45  # of those that carry only clocks and the latest state [s]
FAST_PERIOD = 0.02  # of states on the open fast channel [s]
PROBE_PERIOD = 0.1  # of datagrams on the closed fast channel, which open it [s]
OPEN_TIME = 0.3  # after the last datagram, during which the fast channel counts as open [s]
LARGEST = {0: 140, 1: 1200}  # records of a datagram, by channel [B]
ACKNOWLEDGEMENT_DELAY = 0.2  # for which an acknowledgement waits for other records [s]
LONGEST_WAIT = 0.5  # of messages for bytes that states leave; then one is sent with the next state [s]
FAST_DATAGRAMS = 16  # on the fast channel in one turn
ACKNOWLEDGED_PARTS = 40  # in one acknowledgement


class Channel(IntEnum):
    """Channel of a datagram."""

    SLOW = 0
    FAST = 1


@dataclass(frozen=True)
class Arrived:
    """A complete message, delivered once."""

    kind: MessageClass
    id: int
    content: bytes
    rejection: str = ""  # reason not to execute it; empty if it is in time


@dataclass(frozen=True)
class SessionStarted:
    """A new session: pending messages of the last one are lost."""


@dataclass(frozen=True)
class MessagesExpired:
    """Messages not acknowledged before their deadline, or overtaken by a stop."""

    ids: frozenset[int]


Event = Arrived | SessionStarted | MessagesExpired


class LinkEndpoint:
    """Common part of both ends."""

    def __init__(self, session: Session, rates: Rates, now: float, fast: bool) -> None:
        self._has_fast = fast
        self.session, self._rates, self._started = session, rates, now
        self._budget = Budget(rates, now)
        self.meter, self.received_meter = Meter(), Meter()  # bytes on the slow channel
        self.rejected = 0  # number of datagrams
        self._received_at = {Channel.SLOW: -1e9, Channel.FAST: -1e9}
        self._hello_due = self._reply_due = self._acknowledgement_due = now
        self._regular_due = {Channel.SLOW: now, Channel.FAST: now}
        self._acknowledged_at = self._messages_sent_at = now
        self._reply: tuple[Channel, bytes] | None = None  # of the handshake
        self._events: list[Event] = []
        self._reset()

    def _reset(self) -> None:
        self.other = OtherClock()  # bounds of the other end's clock
        self._outbox, self._inbox = Outbox(), Inbox()
        self._to_acknowledge: set[tuple[int, int]] = set()
        self._echo: tuple[float, float] | None = None  # the other end's clock, and when it was received
        self._stream: dict[MessageClass, bytes] = {}
        self._latest_counter = 0  # of a received state or stream
        self._barrier = 0  # id of the latest stop

    def clock(self, now: float) -> float:
        """Clock of this end [s]."""
        return now - self._started

    def silence(self, now: float) -> float:
        """Time since the last datagram of this session [s]."""
        return now - max(self._received_at.values())

    def fast(self, now: float) -> bool:
        """Whether the fast channel is open."""
        return now - self._received_at[Channel.FAST] < OPEN_TIME

    def send(self, kind: MessageClass, content: bytes, now: float) -> int:
        """Send a message until it is acknowledged or its deadline passes; returns its id.

        A stop removes all commands that wait. Raises SealError: no session, or the message is too long.
        """
        lifetime = BY_CLASS[kind].deadline
        if not self.session.established:
            raise SealError(self.session.mismatch or "no datagram of the other end has been received")
        if kind is MessageClass.STOP:
            self._expire(lambda message: message.kind is MessageClass.COMMAND)
            self._stream.clear()
        deadline = NO_DEADLINE if lifetime is None else self._deadline(lifetime, now)
        return self._outbox.put(kind, content, now, deadline)

    def replace(self, kind: MessageClass, content: bytes, now: float, before: int = 0) -> int:
        """Like ``send``; the message with the id ``before`` is not repeated any more."""
        self._outbox.abandon(lambda message: message.id == before)
        return self.send(kind, content, now)

    def stream(self, kind: MessageClass, content: bytes, now: float) -> None:
        """Send the latest message of a stream once; errors like ``send``."""
        lifetime = BY_CLASS[kind].deadline or 0.0
        self._stream[kind] = self._deadline(lifetime, now).to_bytes(4, "big") + content

    def _expire(self, which: Callable[[Message], bool]) -> None:
        if expired := self._outbox.abandon(which):
            self._events.append(MessagesExpired(frozenset(expired)))

    def _deadline(self, lifetime: float, now: float) -> int:
        other = self.other.lower_bound(now)
        if other < 0.0:
            raise SealError("no datagram of the other end has been received")
        return int(1e3 * (other + lifetime))

    def receive(self, data: bytes, channel: Channel, now: float) -> bool:
        """Process a datagram; ``events`` returns its messages. False if it is rejected."""
        before = self.session.number
        try:
            if data[:1] != bytes((SEALED,)):
                reply = self.session.receive(data)
                self._reply = (channel, reply) if reply else self._reply
                self._begin_session(before)
                return True
            content, counter = self.session.open(data)
            self._begin_session(before)
            self._received_at[channel] = now
            shares = Counter(headers=HEADERS + OVERHEAD)
            for kind, body in records(content):
                shares[kind.name.lower()] += len(body)
                self._take(kind, body, counter, now)
            if channel is Channel.SLOW:
                self.received_meter.count(shares, now)
            return True
        except SealError:
            self.rejected += 1
            return False

    def _begin_session(self, before: int) -> None:
        """Reset if the session is not ``before``."""
        if self.session.number != before:
            self._reset()
            self._events.append(SessionStarted())

    def events(self) -> list[Event]:
        """Events since the last call."""
        found, self._events = self._events, []
        return found

    def _take(self, kind: MessageClass, body: bytes, counter: int, now: float) -> None:
        if kind is MessageClass.ACKNOWLEDGEMENT:
            self._acknowledged(Acknowledgement.read(body), now)
        elif kind is MessageClass.STATE:
            self._state_received(body, counter, now)
        elif kind is MessageClass.PICTURE:
            self._picture_received(body)
        elif kind is MessageClass.STREAM:
            if self._in_time(int.from_bytes(body[:4], "big"), now) and counter >= self._latest_counter:
                self._latest_counter = counter
                self._events.append(Arrived(kind, 0, body[4:]))
        else:
            if kind is MessageClass.STOP:  # bars streams, too
                self._latest_counter = max(self._latest_counter, counter)
            self._message_received(Message.read(kind, body), now)

    def _message_received(self, message: Message, now: float) -> None:
        self._to_acknowledge.add((message.id, message.part))
        self._acknowledge_by(now + ACKNOWLEDGEMENT_DELAY)
        content = self._inbox.take(message)
        if content is None:
            return
        rejection = ""
        if message.kind is MessageClass.STOP:
            self._barrier = max(self._barrier, message.id)
        elif message.kind is MessageClass.COMMAND and message.id < self._barrier:
            rejection = "a stop was sent after it"
        if not self._in_time(message.deadline, now):
            rejection = f"received {self.clock(now) - message.deadline / 1e3:.1f} s after its deadline"
        self._events.append(Arrived(message.kind, message.id, content, rejection))

    def _in_time(self, deadline: int, now: float) -> bool:
        return deadline == NO_DEADLINE or 1e3 * self.clock(now) <= deadline

    def _acknowledged(self, received: Acknowledgement, now: float) -> None:
        for each in received.messages:
            self._outbox.acknowledged(*each)
        self.other.received(received.clock / 1e3, now)
        if received.echo:
            self.other.echoed(received.clock / 1e3, received.echo / 1e3 + self._started, now)
        self._echo = (received.clock / 1e3, now)
        self._state_acknowledged(received.state)

    def _state_acknowledged(self, counter: int) -> None:
        """Process the acknowledgement of the state in the datagram with this counter."""

    def _state_received(self, data: bytes, counter: int, now: float) -> None:
        """Process a state."""

    def _state(self, counter: int, now: float) -> bytes:
        """Encoded state for the datagram with this counter; empty if there is none."""
        return b""

    def _picture_received(self, body: bytes) -> None:
        """Process a ``PICTURE`` record: a chunk on the operator's end, an acknowledgement on the robot's."""

    def _picture_records(self, now: float) -> list[bytes]:
        """Bodies of ``PICTURE`` records to send on the fast channel at ``now`` [s]."""
        return []

    def turn(self, now: float) -> list[tuple[Channel, bytes]]:
        """Datagrams to send now; ``now``: monotonic [s]."""
        sent: list[tuple[Channel, bytes]] = []
        if now >= self._hello_due and (not self.session.established or self.silence(now) > SILENCE):
            self._hello_due = now + HELLO_PERIOD
            sent += [(Channel.SLOW, self._counted_hello(each, now)) for each in self.session.requests()]
        if self._reply is not None and now >= self._reply_due:
            self._reply_due = now + REPLY_PERIOD
            sent.append((self._reply[0], self._counted_hello(self._reply[1], now)))
            self._reply = None
        return [*sent, *self._datagrams(now)] if self.session.established else sent

    def _datagrams(self, now: float) -> Iterator[tuple[Channel, bytes]]:
        other = 1e3 * self.other.lower_bound(now)
        self._expire(lambda message: message.deadline != NO_DEADLINE and other > message.deadline)
        for _ in range((FAST_DATAGRAMS if self.fast(now) else 1) * self._has_fast):
            if not (datagram := self._datagram(Channel.FAST, now)[0]):
                break
            yield Channel.FAST, datagram
        if self.fast(now):
            for body in self._picture_records(now):
                yield Channel.FAST, self.session.seal(record(MessageClass.PICTURE, body))
        while (made := self._datagram(Channel.SLOW, now))[0]:
            yield Channel.SLOW, made[0]
            if made[1] and self.fast(now):  # urgent: the same datagram twice, of which the first to arrive counts
                yield Channel.FAST, made[0]

    def _counted_hello(self, data: bytes, now: float) -> bytes:
        self._budget.spend(len(data), now)
        self.meter.count({"hello": len(data) + HEADERS}, now)
        return data

    def _datagram(self, channel: Channel, now: float) -> tuple[bytes, bool]:
        """Next datagram of a channel, and whether it is urgent; empty if none is due or the budget is spent."""
        slow = channel is Channel.SLOW
        left = self._budget.left(now) if slow else math.inf
        due = self._outbox.due(now) if slow or self.fast(now) else []
        regular = left > 0.0 and now >= self._regular_due[channel]
        with_messages = bool(due) and self._rates.loaded_period is None
        own = self._own(channel, now, regular, with_messages) if left > 0.0 else []
        room = LARGEST[channel] - _size(own) * (not slow)
        spare = self._spare(left, own, regular) if slow else math.inf
        taken: list[tuple[TrafficClass, bytes]] = []
        for message in due:
            each, made = BY_CLASS[message.kind], message.record()
            fits = len(made) <= spare or (regular and not taken and now - self._messages_sent_at > LONGEST_WAIT)
            if len(made) > room or not (fits or each.urgent) or (not slow and each.urgent):
                continue
            taken.append((each, made))
            room, spare = room - len(made), spare - len(made)
            self._outbox.sent(message, now)
        if slow and (taken or not due):
            self._messages_sent_at = now
        if regular:
            self._schedule_regular(channel, now, waiting=len(taken) < len(due))
        if not (parts := taken + own):
            return b"", False
        return self._sealed(parts, slow, now), any(each.urgent for each, _ in taken)

    def _spare(self, left: float, own: list[tuple[TrafficClass, bytes]], regular: bool) -> float:
        """Bytes that messages may use on the slow channel now without a delay of the next state [B]."""
        if left <= 0.0:
            return 0.0
        if self._rates.loaded_period is None:
            return math.inf
        if not regular:
            return 0.0
        return left - _size(own) - HEADERS - OVERHEAD + self._rates.budget * self._rates.loaded_period

    def _schedule_regular(self, channel: Channel, now: float, waiting: bool) -> None:
        """Set the time of the next regular datagram; ``waiting``: messages did not fit into this one."""
        if channel is Channel.FAST:
            period = FAST_PERIOD if self.fast(now) else PROBE_PERIOD
        elif waiting and self._rates.loaded_period is not None:
            period = self._rates.loaded_period
        else:
            period = self._rates.period
        self._regular_due[channel] = max(self._regular_due[channel] + period, now)

    def _own(
        self, channel: Channel, now: float, regular: bool, with_messages: bool
    ) -> list[tuple[TrafficClass, bytes]]:
        """Unreliable records: acknowledgement, streams, state; ``with_messages``: messages are sent with them."""
        parts = []
        is_open = channel is Channel.SLOW or self.fast(now)
        pending = bool(self._to_acknowledge) and is_open and (regular or with_messages or channel is Channel.FAST)
        probe = regular and channel is Channel.FAST
        if probe or pending or (regular and now >= self._acknowledgement_due):
            if channel is Channel.SLOW:
                self._acknowledgement_due = now + ACKNOWLEDGEMENT_PERIOD
            parts.append((BY_CLASS[MessageClass.ACKNOWLEDGEMENT], self._acknowledgement(now, is_open)))
        if is_open:
            parts += [(BY_CLASS[kind], record(kind, body)) for kind, body in self._stream.items()]
            self._stream.clear()
        if regular and is_open and (state := self._state(self.session.next_counter, now)):
            parts.append((BY_CLASS[MessageClass.STATE], record(MessageClass.STATE, state)))
        return parts

    def _acknowledge_by(self, at: float) -> None:
        """Send an acknowledgement at that time at the latest."""
        self._regular_due[Channel.SLOW] = min(self._regular_due[Channel.SLOW], at)
        self._acknowledgement_due = min(self._acknowledgement_due, at)

    def _acknowledgement(self, now: float, is_open: bool) -> bytes:
        echo = 0 if self._echo is None else round(1e3 * (self._echo[0] + now - self._echo[1]))
        messages = sorted(self._to_acknowledge)[: ACKNOWLEDGED_PARTS * is_open]
        self._to_acknowledge.difference_update(messages)
        clock = round(1e3 * self.clock(now))
        self._acknowledged_at = now
        return Acknowledgement(self._latest_counter, clock, echo, tuple(messages)).record()

    def _sealed(self, parts: list[tuple[TrafficClass, bytes]], slow: bool, now: float) -> bytes:
        datagram = self.session.seal(b"".join(made for _, made in parts))
        if slow:
            shares = Counter(headers=HEADERS + OVERHEAD)
            for each, made in parts:
                shares[each.kind.name.lower()] += len(made)
            self.meter.count(shares, now)
            self._budget.spend(len(datagram), now)
        return datagram


def _size(parts: list[tuple[TrafficClass, bytes]]) -> int:
    return sum(len(made) for _, made in parts)
