"""Clients: one request at a time, sent at most once, with a timeout; blocking or polled."""

import secrets
import time
from dataclasses import dataclass
from struct import error as StructError  # noqa: N812
from typing import Generic, TypeVar

import zmq

from bifrost import wire
from bifrost.clocks import OWN_CLOCK
from bifrost.directory import Entry
from bifrost.discovery import Discovery
from bifrost.encoding import codec
from bifrost.errors import Error, NoServerError, RemoteError, SchemaError, TimeoutError
from bifrost.messages import M, Message
from bifrost.neighbors import Peer

R = TypeVar("R", bound=Message)
_AGAIN = 0.01  # polling interval of a request that waits for a connection [s]
_SLICE = 0.05  # polling interval of the table while the connection is being made [s]


@dataclass
class _Asked:
    """An open request."""

    payload: bytes
    deadline: float  # monotonic [s]
    timeout: float  # [s]
    server: Peer | None = None  # receiver, once it was sent


class Client(Generic[M, R]):
    """Sends requests to the server of one topic. Made by ``Node.client``.

    Threads that may block use ``call``; loops use ``ask``, ``bifrost.wait`` and ``answer``.
    """

    def __init__(self, discovery: Discovery, topic: str, request: type[M], reply: type[R]) -> None:
        self.topic = topic
        self._discovery = discovery
        self._request_type = request
        self._request, self._reply = codec(request), codec(reply)
        self._hashes = (self._request.hash.hex(), self._reply.hash.hex())
        self._prefix = topic.encode() + b"\0"
        self._computer = wire.computer_id()
        self._origin = discovery.name.encode()
        self._request_id = secrets.randbits(63)  # unique for each client and each run
        self._socket: zmq.Socket[bytes] | None = None
        self._endpoint = ""
        self._closed = False
        self._asked: _Asked | None = None
        self._answer: R | Exception | None = None
        self._watch = discovery.watch("server", topic, notify=lambda: None)
        entry = Entry("client", topic, (self._request.name, self._reply.name), self._hashes)
        self._key = discovery.announce(entry, [self._request.schema, self._reply.schema], self)

    def call(self, request: M, timeout: float = 1.0) -> R:
        """Send a request, at most once, and wait for its reply. After an error, the server may have handled it.

        Args:
            request: of the client's type.
            timeout: total, including the wait for a server that starts later [s].

        Raises:
            NoServerError: the topic has no server.
            TimeoutError: the server has not replied.
            SchemaError: the server has other types.
            RemoteError: the server rejected the request, or its handler raised.
            TypeError: the request or a field is of another type.
        """
        self.ask(request, timeout)
        while self._asked is not None:
            self._wait(self._asked)
            self._advance()
        answer = self.answer()
        assert answer is not None
        return answer

    def ask(self, request: M, timeout: float = 1.0) -> None:
        """Send a request as ``call``; ``answer`` returns the reply. Never blocks. An open request is abandoned."""
        if type(request) is not self._request_type:
            raise TypeError(f"{self.topic}: expected {self._request.name}, got {type(request).__name__}")
        payload = self._request.encode(request)
        self._answer = None
        self._asked = _Asked(payload, time.monotonic() + timeout, timeout)
        self._advance()

    def answer(self) -> R | None:
        """The reply, once; None while there is none. Never blocks. Raises Error as ``call``, and closes the request."""
        self._advance()
        answer, self._answer = self._answer, None
        if isinstance(answer, Exception):
            raise answer
        return answer

    @property
    def pollable(self) -> zmq.Socket[bytes] | None:
        """Socket for ``bifrost.wait``; None while there is none to poll."""
        return self._socket if self._asked is not None and self._asked.server is not None else None

    def ready(self) -> bool:
        """Return whether the last request has a reply or an error. Never blocks."""
        self._advance()
        return self._answer is not None

    def patience(self) -> float | None:
        """Zero if a reply or error is stored; None without a request; otherwise time until the next check [s]."""
        if self._asked is None:
            return None if self._answer is None else 0.0
        remaining = max(0.0, self._asked.deadline - time.monotonic())
        return remaining if self._asked.server is not None else min(_AGAIN, remaining)

    @property
    def server(self) -> str | None:
        """Name of the node that serves the topic, or None."""
        peers = self._watch.peers
        return peers[-1].node if peers else None

    def wait_for_server(self, timeout: float) -> bool:
        """Wait until the topic has a server; False after ``timeout`` [s]."""
        return self._discovery.wait_change(lambda: bool(self._watch.peers), timeout)

    def close(self) -> None:
        """Withdraw the client and close its socket."""
        if not self._closed:
            self._closed = True
            self._discovery.unwatch(self._watch)
            self._discovery.withdraw(self._key)
            self._disconnect()

    def _wait(self, asked: _Asked) -> None:
        remaining = max(0.0, asked.deadline - time.monotonic())
        if self._socket is not None and asked.server is not None:
            self._socket.poll(int(remaining * 1000) + 1)
        elif self._socket is not None and self._watch.peers:
            self._socket.poll(int(min(_SLICE, remaining) * 1000) + 1, zmq.POLLOUT)
        else:
            self.wait_for_server(remaining)

    def _frame(self, payload: bytes, deadline: float, server: Peer) -> bytes:
        """The frame of a new request; to another computer with the deadline by its clock, if the offset is known."""
        computer, until = self._computer, int(deadline * 1e9)
        clock = self._discovery.clock(server.computer)
        if clock is not OWN_CLOCK and clock.known:
            computer, until = wire.SERVERS_CLOCK, until + clock.ahead
        self._request_id = (self._request_id + 1) % 2**63
        header = wire.REQUEST.pack(
            wire.VERSION, self._request.hash, self._reply.hash, self._request_id, computer,
            until, len(self._origin),
        )  # fmt: skip
        return b"".join((self._prefix, header, self._origin, payload))

    def _advance(self) -> None:
        """Advance an open request as far as possible without waiting."""
        asked = self._asked
        if asked is None:
            return
        try:
            if asked.server is None:
                self._send(asked)
            if asked.server is not None and self._socket is not None:
                while self._answer is None:
                    self._answer = self._take(self._socket.recv(zmq.NOBLOCK), asked.server)
        except zmq.Again:
            pass
        except Error as error:
            self._answer = error
        if self._answer is None and time.monotonic() >= asked.deadline:
            self._answer = self._too_late(asked)
            self._disconnect()  # or a queued request would be sent later
        if self._answer is not None:
            self._asked = None

    def _send(self, asked: _Asked) -> None:
        """Send a request if a server is connected."""
        if not self._watch.peers:
            return
        server = self._watch.peers[-1]
        if server.entry.hashes != self._hashes:
            raise SchemaError(
                f"{self.topic}: {server.node} serves {' -> '.join(server.entry.types)} "
                f"({' -> '.join(server.entry.hashes)}), {self._discovery.name} requests "
                f"{self._request.name} -> {self._reply.name} ({' -> '.join(self._hashes)})"
            )
        self._connect(server.entry).send(self._frame(asked.payload, asked.deadline, server), zmq.NOBLOCK)
        asked.server = server

    def _too_late(self, asked: _Asked) -> Error:
        within, peers = f"within {asked.timeout:g} s", self._watch.peers
        if asked.server is not None:
            return TimeoutError(f"{self.topic}: no reply from {asked.server.node} {within}")
        if peers:
            return TimeoutError(f"{self.topic}: no connection to {peers[-1].node} {within}")
        daemon = "" if self._discovery.connected else f"; {self._discovery.daemon_silent}"
        return NoServerError(f"{self.topic}: no server {within}{daemon}")

    def _connect(self, entry: Entry) -> zmq.Socket[bytes]:
        if self._socket is None or entry.endpoint != self._endpoint:
            self._disconnect()
            self._socket, self._endpoint = self._discovery.connecting_socket(zmq.DEALER), entry.endpoint
            self._socket.setsockopt(zmq.IMMEDIATE, 1)  # no queue without a connection
            try:
                self._discovery.connect(self._socket, entry)
            except zmq.ZMQError as error:  # a member has registered an invalid address
                self._disconnect()
                raise NoServerError(f"{self.topic}: cannot connect to {entry.endpoint!r}: {error.strerror}") from None
        return self._socket

    def _disconnect(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket, self._endpoint = None, ""

    def _take(self, frame: bytes, server: Peer) -> R | None:
        """The reply; None if the frame belongs to another request."""
        try:
            version, request_id, status = wire.REPLY.unpack_from(frame)
        except StructError:
            return None
        if version != wire.VERSION or request_id != self._request_id:
            return None
        payload = memoryview(frame)[wire.REPLY.size :]
        if status == wire.OK:
            try:
                return self._reply.decode(payload)
            except (ValueError, RecursionError) as error:
                raise RemoteError(
                    f"{self.topic}: the reply of {server.node} is not a {self._reply.name}: {error}"
                ) from None
        text = bytes(payload).decode(errors="replace")
        if status == wire.OTHER_SCHEMA:
            raise SchemaError(f"{self.topic}: {text}")
        if status == wire.OTHER_TOPIC:
            raise NoServerError(f"{self.topic}: {server.node} serves {text} there now")
        raise RemoteError(f"{self.topic}: {text}")
