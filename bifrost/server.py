"""Servers: they handle requests in the caller's loop, with one socket each."""

import logging
import time
from collections.abc import Callable
from struct import error as StructError  # noqa: N812
from typing import Generic, TypeVar

import zmq

from bifrost import wire
from bifrost.directory import Entry
from bifrost.discovery import Discovery
from bifrost.encoding import codec
from bifrost.limits import LOOKS, Limit, Meter
from bifrost.messages import M, Message
from bifrost.waiting import Waitable

_log = logging.getLogger("bifrost")
R = TypeVar("R", bound=Message)
_CLIENTS = 1000  # maximum number of metered clients; further ones replace the first


class Server(Waitable, Generic[M, R]):
    """Serves the requests of one topic. Made by ``Node.server``.

    Attributes:
        rejected: requests rejected since start: another schema, not decodable, deadline passed, or of a muted client.
        left: whether requests may remain after the last ``serve``; a ``Poller`` reports them again.
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
        self.rejected = 0
        self.left = False
        self._limit = limit
        self._meters: dict[bytes, Meter] = {}  # by id of the connection
        self._discovery = discovery
        self._request, self._reply = codec(request), codec(reply)
        self._reply_type = reply
        self._handler = handler
        self._topic = topic.encode()
        self._computer = wire.computer_id()
        self._closed = False
        self.socket = discovery.listening_socket(zmq.ROUTER)
        self.socket.setsockopt(zmq.LINGER, 100)  # the last reply is still sent when the node closes
        self.socket.bind(f"tcp://{discovery.network.computer.host}:*")
        entry = Entry(
            "server", topic, (self._request.name, self._reply.name),
            (self._request.hash.hex(), self._reply.hash.hex()), self.socket.getsockopt_string(zmq.LAST_ENDPOINT),
            key=discovery.network.own_key,
        )  # fmt: skip
        self._key = discovery.announce(entry, [self._request.schema, self._reply.schema], self)

    def serve(self, most: int = LOOKS) -> int:
        """Handle waiting requests in this thread; never blocks. Returns the number of replies.

        An exception of the handler is logged, and sent to the client as a RemoteError. After ``most`` requests the
        others remain (``left``); several clients take turns.
        """
        answered = 0
        for _ in range(most):
            try:
                frames = self.socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                self.left = False
                return answered
            if len(frames) != 2 or (self._limit is not None and self._mutes(frames[0], frames[1], self._limit)):
                self.rejected += 1
                continue
            answer = self._answer(frames[1])
            if answer is not None:
                try:
                    self.socket.send_multipart((frames[0], answer), zmq.NOBLOCK)
                except zmq.ZMQError:
                    _log.warning("%s: a client disconnected before its reply", self.topic)
                answered += 1
        self.left = True
        return answered

    @property
    def muted(self) -> tuple[str, ...]:
        """Claimed names of the nodes that exceed the limit, and get no reply at present."""
        now = time.monotonic_ns()
        return tuple(sorted({meter.name for meter in self._meters.values() if meter.muted_until > now}))

    def _mutes(self, who: bytes, frame: bytes, limit: Limit) -> bool:
        meter = self._meters.get(who)
        if meter is None:
            if len(self._meters) >= _CLIENTS:
                del self._meters[next(iter(self._meters))]
            start = len(self._topic) + 1 + wire.REQUEST.size
            length = frame[start - 1] if len(frame) >= start else 0
            name = frame[start : start + length].decode(errors="replace") or "an unnamed client"
            meter = self._meters[who] = Meter(limit, self.topic, name)
        now = time.monotonic_ns()
        return meter.mutes(1, now, now)

    @property
    def pollable(self) -> zmq.Socket[bytes]:
        """Socket for ``bifrost.wait`` and ZeroMQ's pollers."""
        return self.socket

    def ready(self) -> bool:
        """Return whether a request waits. Never blocks."""
        return bool(int(self.socket.getsockopt(zmq.EVENTS)) & zmq.POLLIN)

    def fileno(self) -> int:
        """Descriptor for an event loop; call ``serve`` after each event and before the first wait."""
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
            self.rejected += 1  # the client has timed out; it does not expect the request to be handled
            return None
        try:
            request = self._request.decode(payload)
        except (ValueError, RecursionError) as error:
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
