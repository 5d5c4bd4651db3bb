"""Publishing: one socket a node, one sequence a publisher."""

from __future__ import annotations

import secrets
import threading
import time
from typing import TYPE_CHECKING, Generic

import zmq

from bifrost import wire
from bifrost.directory import Entry
from bifrost.encoding import codec
from bifrost.errors import Error
from bifrost.messages import M

if TYPE_CHECKING:
    from bifrost.node import Node


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


class Publisher(Generic[M]):
    """Publishes messages of one type on one topic. Made by ``Node.publisher``."""

    def __init__(self, node: Node, outlet: Outlet, topic: str, message_type: type[M]) -> None:
        self.topic = topic
        self._node = node
        self._codec = codec(message_type)
        self._encode = self._codec.encode
        self._type = message_type
        self._outlet = outlet
        self._lock = outlet.lock
        self._send = outlet.socket.send
        self._sequence = 0
        incarnation = secrets.randbits(64)  # a publisher made anew is no gap in the sequence
        origin = node.name.encode()
        self._prefix = (
            topic.encode() + b"\0" + wire.PUBLICATION_CONSTANT.pack(wire.VERSION, self._codec.hash, incarnation)
        )
        self._origin = bytes([len(origin)]) + origin
        self._pack = wire.PUBLICATION_VARIABLE.pack
        self._closed = False
        entry = Entry("publisher", topic, (self._codec.name,), (self._codec.hash.hex(),), outlet.endpoint)
        self._key = node.discovery.announce(entry, [self._codec.schema])

    def publish(self, message: M) -> int:
        """Send a message to whoever subscribes; never blocks. Returns its sequence number, from 1.

        Raises:
            TypeError: the message is of another type, or a field does not hold what its type says.
            Error: the publisher is closed, or the message is larger than ``wire.MAX_MESSAGE_SIZE``.
        """
        if type(message) is not self._type:
            raise TypeError(f"{self.topic}: expected {self._type.__name__}, got {type(message).__name__}")
        payload = self._encode(message)
        if self._closed:
            raise Error(f"{self.topic}: the publisher is closed")
        sequence = self._sequence + 1
        frame = b"".join((self._prefix, self._pack(sequence, time.monotonic_ns()), self._origin, payload))
        if len(frame) > wire.MAX_MESSAGE_SIZE:
            raise Error(f"{self.topic}: a message of {len(frame)} bytes; at most {wire.MAX_MESSAGE_SIZE}")
        with self._lock:
            self._send(frame, zmq.NOBLOCK)
        self._sequence = sequence
        return sequence

    def close(self) -> None:
        """Withdraw the topic."""
        if not self._closed:
            self._closed = True
            self._node.discovery.withdraw(self._key)
            self._node.forget(self)
