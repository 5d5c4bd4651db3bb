"""Serving requests: in the caller's own loop, one socket a server."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from struct import error as StructError  # noqa: N812
from typing import Generic, TypeVar

import msgspec
import zmq

from bifrost import wire
from bifrost.directory import Entry
from bifrost.discovery import Discovery
from bifrost.encoding import codec
from bifrost.limits import LOOKS, MUTE, Limit, Meter
from bifrost.messages import M, Message
from bifrost.waiting import Waitable

_log = logging.getLogger("bifrost")
R = TypeVar("R", bound=Message)
_CLIENTS = 1000  # whose requests are counted; of more, the one that came first is counted anew


class Server(Waitable, Generic[M, R]):
    """Answers the requests of one topic. Made by ``Node.server``.

    Attributes:
        rejected: requests refused since start: of another schema, not decodable, older than their client waits, or of
            one that is muted.
        left: whether the last ``serve`` may have left something; a ``Poller`` tells of it again.
        floods: how often a client was muted.
    """

    def __init__(
        self,
        discovery: Discovery,
        topic: str,
        request: type[M],
        reply: type[R],
        handler: Callable[[M, str], R],
        *,
        limit: Limit | None = None,
    ) -> None:
        self.topic = topic
        self.rejected = self.floods = 0
        self.left = False
        self._limit = limit
        self._meters: dict[bytes, Meter] = {}  # by the connection's id
        self._muted: dict[bytes, tuple[str, float]] = {}  # by it: who, as it says, and until when, monotonic [s]
        self._answered = 0
        self._discovery = discovery
        self._request, self._reply = codec(request), codec(reply)
        self._reply_type = reply
        self._handler = handler
        self._topic = topic.encode()
        self._computer = wire.computer_id()
        self._closed = False
        self.socket = discovery.listening_socket(zmq.ROUTER)
        self.socket.setsockopt(zmq.LINGER, 100)  # the last reply still leaves when the node closes
        self.socket.bind(f"tcp://{discovery.network.computer.host}:*")
        entry = Entry(
            "server", topic, (self._request.name, self._reply.name),
            (self._request.hash.hex(), self._reply.hash.hex()), self.socket.getsockopt_string(zmq.LAST_ENDPOINT),
            key=discovery.network.own_key,
        )  # fmt: skip
        schemas = [self._request.schema, self._reply.schema]
        self._key = discovery.announce(entry, schemas, self, lambda: (self._answered, 0, self.rejected))

    def serve(self, most: int = LOOKS) -> int:
        """Answer the requests that wait, in this thread; never blocks. Returns how many it answered.

        What the handler raises goes to the client as a RemoteError, and to the log.

        Args:
            most: take in so many at most; the rest goes on waiting, see ``left``. Several clients' come in turn.
        """
        answered = 0
        for _ in range(most):
            try:
                frames = self.socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                self.left = False
                return answered
            if len(frames) != 2 or (self._limit is not None and self._floods(frames[0], frames[1])):
                self.rejected += 1
                continue
            answer = self._answer(frames[1])
            if answer is not None:
                try:
                    self.socket.send_multipart((frames[0], answer), zmq.NOBLOCK)
                except zmq.ZMQError:
                    _log.warning("%s: a client went away before its reply", self.topic)
                answered += 1
                self._answered += 1
        self.left = True
        return answered

    @property
    def muted(self) -> tuple[str, ...]:
        """Names of the nodes, as they say, that ask more than the limit allows, and are not answered now."""
        if self._muted:
            now = time.monotonic()
            self._muted = {who: told for who, told in self._muted.items() if told[1] > now}
        return tuple(sorted({name for name, _ in self._muted.values()}))

    def _floods(self, who: bytes, frame: bytes) -> bool:
        """Whether a request is one too many of its client, or that one is muted; what is muted and goes on stays so."""
        assert self._limit is not None
        meter = self._meters.get(who)
        if meter is None:
            if len(self._meters) >= _CLIENTS:
                del self._meters[next(iter(self._meters))]
            meter = self._meters[who] = Meter(self._limit)
        now = time.monotonic()
        exceeds = meter.exceeds(1, time.monotonic_ns())
        name, until = self._muted.get(who, ("", 0.0))
        if exceeds:
            if not name:
                name = self._origin(frame)
                self.floods += 1
                _log.warning("%s: %s floods it, and is muted while it goes on", self.topic, name)
            self._muted[who] = (name, now + MUTE)
        return exceeds or until > now

    def _origin(self, frame: bytes) -> str:
        """Who asks, by what the request says."""
        start = len(self._topic) + 1 + wire.REQUEST.size
        length = frame[start - 1] if len(frame) >= start else 0
        return frame[start : start + length].decode(errors="replace") or "a client without a name"

    @property
    def pollable(self) -> zmq.Socket[bytes]:
        """For ``bifrost.wait`` and ZeroMQ's pollers."""
        return self.socket

    def ready(self) -> bool:
        """Whether a request waits. Never blocks."""
        return bool(int(self.socket.getsockopt(zmq.EVENTS)) & zmq.POLLIN)

    def fileno(self) -> int:
        """A descriptor for an event loop; call ``serve`` after it becomes readable and before the first wait."""
        return int(self.socket.getsockopt(zmq.FD))

    def close(self) -> None:
        """Withdraw the topic and close the socket."""
        if not self._closed:
            self._closed = True
            self._discovery.withdraw(self._key)
            self.socket.close()

    def _answer(self, frame: bytes) -> bytes | None:
        topic, _, rest = frame.partition(b"\0")
        try:
            version, request_hash, reply_hash, request_id, computer, deadline, length = wire.REQUEST.unpack_from(rest)
        except StructError:
            self.rejected += 1
            return None
        if version != wire.VERSION:
            self.rejected += 1
            return None
        start = wire.REQUEST.size
        origin = rest[start : start + length].decode(errors="replace")
        payload = memoryview(rest)[start + length :]
        if topic != self._topic:
            return self._refuse(request_id, wire.OTHER_TOPIC, self.topic)
        if (request_hash, reply_hash) != (self._request.hash, self._reply.hash):
            return self._refuse(
                request_id,
                wire.OTHER_SCHEMA,
                f"{self._discovery.name} serves {self._request.name} ({self._request.hash.hex()}) -> "
                f"{self._reply.name} ({self._reply.hash.hex()}), {origin} asked with "
                f"({request_hash.hex()}) -> ({reply_hash.hex()})",
            )
        if computer in (self._computer, wire.SERVERS_CLOCK) and time.monotonic_ns() > deadline:
            self.rejected += 1  # its client has given up: doing it now would surprise everybody
            return None
        try:
            request = self._request.decode(payload)
        except (ValueError, msgspec.DecodeError, RecursionError) as error:
            return self._refuse(request_id, wire.REFUSED, f"not a {self._request.name}: {error}")
        try:
            reply = self._handler(request, origin)
            if type(reply) is not self._reply_type:
                raise TypeError(f"the handler returned {type(reply).__name__}, not {self._reply.name}")
            content = self._reply.encode(reply)
        except Exception as error:
            _log.exception("%s: the handler raised on a request of %s", self.topic, origin)
            text = " ".join(f"{type(error).__name__}: {error}".split())
            return wire.REPLY.pack(wire.VERSION, request_id, wire.REFUSED) + text.encode()
        return wire.REPLY.pack(wire.VERSION, request_id, wire.OK) + content

    def _refuse(self, request_id: int, status: int, text: str) -> bytes:
        self.rejected += 1
        return wire.REPLY.pack(wire.VERSION, request_id, status) + text.encode()
