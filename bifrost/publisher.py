"""Publishers: one socket for each node, one sequence for each publisher."""

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


class PublisherSocket:
    """The socket of all publishers of a node, with a lock for their threads."""

    HIGH_WATER_MARK = 1000  # messages queued for each subscriber; further ones are dropped for it

    def __init__(self, socket: zmq.Socket[bytes], host: str) -> None:
        socket.setsockopt(zmq.SNDHWM, self.HIGH_WATER_MARK)
        socket.setsockopt(zmq.LINGER, 100)  # the last messages are still sent when the node closes
        socket.bind(f"tcp://{host}:*")
        self.endpoint = socket.getsockopt_string(zmq.LAST_ENDPOINT)
        self.socket = socket
        self.lock = threading.Lock()
        # zmq.Socket.send without its checks of arguments that are not used here.
        self._send = functools.partial(zmq.backend.Socket.send, socket)

    def send(self, frame: bytearray) -> None:
        """Send a frame to all subscribers; never blocks."""
        with self.lock:
            self._send(frame, _NOBLOCK)


class Latch(PublisherSocket):
    """The socket of one latched publisher: each new subscriber gets the last message, once.

    The socket (XPUB, manual) does not subscribe peers automatically. Each new peer is subscribed to future messages
    and, temporarily, to the last message, which is sent to it only. ZeroMQ wakes one reader for all events; the holder
    of the lock therefore serves all new peers.
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
        """Send a frame to all subscribers, and store it for later ones; never blocks."""
        with self.lock:
            self._serve_newcomers()
            self._last = bytes(frame)
            self.socket.send(frame, zmq.NOBLOCK)

    def close(self) -> None:
        """Close the socket; later subscribers get no message."""
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
            # These options apply to the sender of the subscription, until libzmq processes other events, as `send` may:
            # the end of another subscription makes it lose the sender. The new peer then also receives messages sent
            # to later peers, and ignores them by their sequence.
            self.socket.setsockopt(zmq.SUBSCRIBE, self._name + bytes([wire.VERSION]))
            if self._last:
                alone = self._name + wire.LATCHED
                self.socket.setsockopt(zmq.SUBSCRIBE, alone)
                self.socket.send(alone + self._last[len(self._name) :], zmq.NOBLOCK)
                self.socket.setsockopt(zmq.UNSUBSCRIBE, alone)


class Publisher(Generic[M]):
    """Publishes messages of one type on one topic. Made by ``Node.publisher``."""

    def __init__(self, discovery: Discovery, socket: PublisherSocket, topic: str, message_type: type[M]) -> None:
        self.topic = topic
        self._discovery = discovery
        self._codec = codec(message_type)
        self._encode_into = self._codec.encode_into
        self._type = message_type
        self._socket = socket
        self._send = socket.send
        self._sequence = 0
        incarnation = secrets.randbits(64)  # a new publisher is not a gap in the sequence
        origin = discovery.name.encode()
        constant = topic.encode() + b"\0" + wire.PUBLICATION_CONSTANT.pack(wire.VERSION, self._codec.hash, incarnation)
        # One buffer for all messages: each overwrites the variable parts. ZeroMQ copies it.
        self._frame = bytearray(constant + bytes(wire.PUBLICATION_VARIABLE.size) + bytes([len(origin)]) + origin)
        self._variable, self._payload = len(constant), len(self._frame)
        self._pack_into = wire.PUBLICATION_VARIABLE.pack_into
        self._closed = False
        latched = isinstance(socket, Latch)
        key = discovery.network.own_key
        entry = Entry("publisher", topic, (self._codec.name,), (self._codec.hash.hex(),), socket.endpoint, latched, key)
        self._key = discovery.announce(entry, [self._codec.schema], self)

    def publish(self, message: M) -> int:
        """Send a message to all subscribers; never blocks. Returns its sequence number, from 1.

        Raises:
            TypeError: the message or a field is of another type.
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
        """Number of peers connected to a latched publisher; 0 for others, which cannot count them."""
        return self._socket.subscribers if isinstance(self._socket, Latch) else 0

    def close(self) -> None:
        """Withdraw the topic."""
        if not self._closed:
            self._closed = True
            self._discovery.withdraw(self._key)
            if isinstance(self._socket, Latch):
                self._socket.close()
