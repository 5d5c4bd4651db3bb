"""Publishing: one socket a node, one sequence a publisher."""

from __future__ import annotations

import functools
import secrets
import threading
from time import monotonic_ns
from typing import Generic

import zmq

from bifrost import wire
from bifrost.directory import Entry
from bifrost.discovery import Discovery
from bifrost.encoding import codec
from bifrost.errors import Error
from bifrost.messages import M

_NOBLOCK = int(zmq.NOBLOCK)
_MAX_SIZE = wire.MAX_MESSAGE_SIZE


class Outlet:
    """The socket that all publishers of a node share, with the lock that lets them live in different threads."""

    HIGH_WATER_MARK = 1000  # messages held for a subscriber that does not read; more are dropped for it alone

    def __init__(self, socket: zmq.Socket[bytes], host: str) -> None:
        socket.setsockopt(zmq.SNDHWM, self.HIGH_WATER_MARK)
        socket.setsockopt(zmq.LINGER, 100)  # what was published last still leaves when the node closes
        socket.bind(f"tcp://{host}:*")
        self.endpoint = socket.getsockopt_string(zmq.LAST_ENDPOINT)
        self.socket = socket
        self.lock = threading.Lock()
        # What zmq.Socket.send calls when it has looked at arguments that are not given here.
        self._send = functools.partial(zmq.backend.Socket.send, socket)

    def send(self, frame: bytearray) -> None:
        """Give a frame to whoever subscribes; never blocks."""
        with self.lock:
            self._send(frame, _NOBLOCK)


class Latch(Outlet):
    """The socket of one latched publisher: whoever subscribes gets the last message, once and for itself.

    The socket (XPUB, manual) subscribes nobody by itself. Each newcomer is subscribed to what is published and, for a
    moment, to the last message, sent to it alone. ZeroMQ wakes one reader for all that has come; whoever takes
    the lock therefore serves all newcomers.
    """

    def __init__(self, socket: zmq.Socket[bytes], host: str, topic: str, discovery: Discovery) -> None:
        socket.setsockopt(zmq.XPUB_MANUAL, 1)
        super().__init__(socket, host)
        self._subscription = b"\x01" + topic.encode() + b"\0"
        self._end_of_subscription = b"\0" + topic.encode() + b"\0"
        self._name = topic.encode() + b"\0"
        self._last = b""
        self.subscribers = 0
        self._discovery = discovery
        self._descriptor = int(socket.getsockopt(zmq.FD))
        discovery.attend(self._descriptor, self._admit)

    def send(self, frame: bytearray) -> None:
        """Give a frame to whoever subscribes, and keep it for those to come; never blocks."""
        with self.lock:
            self._serve_newcomers()
            self._last = bytes(frame)
            self.socket.send(frame, zmq.NOBLOCK)

    def close(self) -> None:
        """Close the socket; from now on newcomers get nothing."""
        self._discovery.leave_alone(self._descriptor, self.socket.close)

    def _admit(self) -> None:
        with self.lock:
            self._serve_newcomers()

    def _serve_newcomers(self) -> None:
        while True:
            try:
                subscription = self.socket.recv(zmq.NOBLOCK)
            except zmq.Again:
                return
            if subscription == self._end_of_subscription:
                self.subscribers -= 1
            if subscription != self._subscription:
                continue
            self.subscribers += 1
            # What is set here concerns the subscription's sender, until libzmq looks at its mail, as `send` may: the
            # end of another subscription found there makes it forget whom this is about. Then the newcomer goes on
            # hearing what is sent to later ones alone; it knows that it has had that.
            self.socket.setsockopt(zmq.SUBSCRIBE, self._name + bytes([wire.VERSION]))
            if self._last:
                alone = self._name + wire.LATCHED
                self.socket.setsockopt(zmq.SUBSCRIBE, alone)
                self.socket.send(alone + self._last[len(self._name) :], zmq.NOBLOCK)
                self.socket.setsockopt(zmq.UNSUBSCRIBE, alone)


class Publisher(Generic[M]):
    """Publishes messages of one type on one topic. Made by ``Node.publisher``."""

    def __init__(self, discovery: Discovery, outlet: Outlet, topic: str, message_type: type[M]) -> None:
        self.topic = topic
        self._discovery = discovery
        self._codec = codec(message_type)
        self._encode_into = self._codec.encode_into
        self._type = message_type
        self._outlet = outlet
        self._send = outlet.send
        self._sequence = 0
        incarnation = secrets.randbits(64)  # a publisher made anew is no gap in the sequence
        origin = discovery.name.encode()
        constant = topic.encode() + b"\0" + wire.PUBLICATION_CONSTANT.pack(wire.VERSION, self._codec.hash, incarnation)
        # One buffer for all messages: of each, what differs is written over the last. ZeroMQ takes a copy.
        self._frame = bytearray(constant + bytes(wire.PUBLICATION_VARIABLE.size) + bytes([len(origin)]) + origin)
        self._variable, self._payload = len(constant), len(self._frame)
        self._pack_into = wire.PUBLICATION_VARIABLE.pack_into
        self._closed = False
        latched = isinstance(outlet, Latch)
        key = discovery.network.own_key
        entry = Entry("publisher", topic, (self._codec.name,), (self._codec.hash.hex(),), outlet.endpoint, latched, key)
        self._key = discovery.announce(entry, [self._codec.schema], self, lambda: (self._sequence, 0, 0))

    def publish(self, message: M) -> int:
        """Send a message to whoever subscribes; never blocks. Returns its sequence number, from 1.

        Raises:
            TypeError: the message is of another type, or a field does not hold what its type says.
            Error: the publisher is closed, or the message is larger than ``wire.MAX_MESSAGE_SIZE``.
        """
        if type(message) is not self._type:
            raise TypeError(f"{self.topic}: expected {self._type.__name__}, got {type(message).__name__}")
        frame = self._frame
        try:
            self._encode_into(message, frame, self._payload)
        except TypeError as error:
            raise TypeError(f"{self.topic}: {error}") from None
        if self._closed:
            raise Error(f"{self.topic}: the publisher is closed")
        sequence = self._sequence + 1
        self._pack_into(frame, self._variable, sequence, monotonic_ns())
        if len(frame) > _MAX_SIZE:
            raise Error(f"{self.topic}: a message of {len(frame)} bytes; at most {_MAX_SIZE}")
        self._send(frame)
        self._sequence = sequence
        return sequence

    @property
    def subscribers(self) -> int:
        """How many are connected to a latched publisher; of another, which cannot know, none."""
        return self._outlet.subscribers if isinstance(self._outlet, Latch) else 0

    def close(self) -> None:
        """Withdraw the topic."""
        if not self._closed:
            self._closed = True
            self._discovery.withdraw(self._key)
            if isinstance(self._outlet, Latch):
                self._outlet.close()
