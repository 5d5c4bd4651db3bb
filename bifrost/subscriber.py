"""Subscribing: one socket a subscriber, so that depth and pace are its own."""

from __future__ import annotations

import contextlib
import logging
import time
from collections import deque
from struct import error as StructError  # noqa: N812
from typing import TYPE_CHECKING, Any, Generic

import msgspec
import zmq

from bifrost import wire
from bifrost.directory import Entry
from bifrost.encoding import Codec, codec
from bifrost.errors import SchemaError
from bifrost.messages import M, Message
from bifrost.schema import type_from_schema

if TYPE_CHECKING:
    from bifrost.node import Node

_log = logging.getLogger("bifrost")
_WARNINGS = 20  # a subscriber's, at most; the rest is counted


class Received(msgspec.Struct, Generic[M], gc=False, eq=False):
    """A message and its envelope.

    Attributes:
        message: decoded; its arrays are read-only.
        stamp: when it was published, by the monotonic clock of the publisher's computer [ns].
        sequence: the publisher's count, from 1.
        origin: name of the node that published it.
    """

    message: M
    stamp: int
    sequence: int
    origin: str


class Subscriber(Generic[M]):
    """Receives the messages of one topic. Made by ``Node.subscriber``.

    Attributes:
        drops: messages known lost, by gaps in the sequence, since start. A latest-value subscriber loses none: what
            newer messages replace is not counted.
        rejected: messages refused since start: of another schema, or not decodable.
        bytes_received: of all messages since start, envelopes included, encryption not [B].
    """

    def __init__(self, node: Node, topic: str, message_type: type[M] | None, queue: int | None) -> None:
        self.topic = topic
        self.drops = 0
        self.rejected = 0
        self.bytes_received = 0
        self._node = node
        self._codec: Codec[M] | None = None if message_type is None else codec(message_type)
        self._codecs: dict[bytes, Codec[Any]] = {}
        if self._codec is not None:
            self._codecs[self._codec.hash] = self._codec
        self._keep_all = queue is not None
        self._prefix = topic.encode() + b"\0"
        self._header = len(self._prefix)
        self._payload = self._header + wire.PUBLICATION.size
        self._unpack = wire.PUBLICATION.unpack_from
        self._last: dict[int, int] = {}  # incarnation to its last sequence
        self._waiting: deque[tuple[int, int, bytes]] = deque()  # stamp, sequence, frame: checked but not delivered
        self._connected: set[str] = set()
        self._warned: set[bytes | str] = set()
        self._closed = False
        self._timeout = -2
        self._watch = node.discovery.watch("publisher", topic)
        self.socket = node.connecting_socket(zmq.SUB)
        if queue is None:
            self.socket.setsockopt(zmq.CONFLATE, 1)
        else:
            self.socket.setsockopt(zmq.RCVHWM, queue)
        self.socket.setsockopt(zmq.SUBSCRIBE, self._prefix)
        self._recv = self.socket.recv
        node.connect_wake(self.socket)
        types, hashes, schemas = ((), (), ()) if self._codec is None else (
            (self._codec.name,), (self._codec.hash.hex(),), (self._codec.schema,),
        )  # fmt: skip
        self._key = node.discovery.announce(Entry("subscriber", topic, types, hashes), schemas)
        self._connect()

    # --- for the user ---------------------------------------------------------------------------------------------

    def latest(self) -> Received[M] | None:
        """The newest message not yet returned, or None; older ones are passed over. Never blocks."""
        while True:
            while self._pump():
                pass
            if not self._waiting:
                return None
            newest = max(self._waiting)
            self._waiting.clear()
            received = self._decode(newest)
            if received is not None:
                return received

    def receive(self, timeout: float | None = None) -> Received[M] | None:
        """The next message; for a latest-value subscriber the newest.

        Args:
            timeout: how long to wait [s]; None: for ever. Zero or less: not at all.

        Returns:
            None after the time-out.
        """
        if timeout is not None and timeout <= 0.0:
            return self._next() if self._keep_all else self.latest()
        deadline = 0.0 if timeout is None else time.monotonic() + timeout
        milliseconds = -1 if timeout is None else int(timeout * 1000.0) + 1
        while True:
            # What waits is returned by the same call that would wait: one call into ZeroMQ a message.
            if self._waiting or self._wait(milliseconds):
                several = len(self._connected) > 1  # each publisher has a newest message of its own
                received = self._next() if self._keep_all or not several else self.latest()
                if received is not None:
                    return received
            if timeout is not None:
                remaining = deadline - time.monotonic()
                if remaining <= 0.0:
                    return None
                milliseconds = int(remaining * 1000.0) + 1

    def drain(self) -> list[Received[M]]:
        """All messages that wait, oldest first; of a latest-value subscriber at most one. Never blocks."""
        if not self._keep_all:
            received = self.latest()
            return [] if received is None else [received]
        messages = []
        while (received := self._next()) is not None:
            messages.append(received)
        return messages

    def fileno(self) -> int:
        """A descriptor for an event loop.

        It becomes readable when something *may* have come, and it tells so once: after it has, and after every call
        here, call ``drain`` or ``latest`` until nothing is left before waiting for it again.
        """
        return int(self.socket.getsockopt(zmq.FD))

    @property
    def publishers(self) -> tuple[str, ...]:
        """Names of the nodes that it is connected to, without those that are known to be gone."""
        return tuple(peer.node for peer in self._watch.peers if peer.alive and peer.entry.endpoint in self._connected)

    @property
    def mismatches(self) -> list[SchemaError]:
        """One error for every publisher of the topic whose type is another: such are not listened to."""
        return [
            self._mismatch(peer.node, peer.entry.types, peer.entry.hashes)
            for peer in self._watch.peers
            if not self._suits(peer.entry)
        ]

    def ready(self) -> bool:
        """Whether a message waits. Never blocks."""
        return bool(self._waiting) or self._pump()

    def holding(self) -> bool:
        """Whether a message waits outside the socket, where polling does not see it."""
        return bool(self._waiting)

    def close(self) -> None:
        """Unsubscribe and close the socket."""
        if not self._closed:
            self._closed = True
            self._node.discovery.unwatch(self._watch)
            self._node.discovery.withdraw(self._key)
            self.socket.close()
            self._node.forget(self)

    # --- receiving ------------------------------------------------------------------------------------------------

    def _wait(self, milliseconds: int) -> bool:
        """Block until something arrives, and take it; whether it is a message."""
        if milliseconds != self._timeout:
            self.socket.setsockopt(zmq.RCVTIMEO, milliseconds)
            self._timeout = milliseconds
        try:
            frame = self._recv()
        except zmq.Again:
            return False
        return self._take(frame)

    def _pump(self) -> bool:
        """Take one message from the socket into ``_waiting``; False when there is none."""
        while True:
            try:
                frame = self._recv(zmq.NOBLOCK)
            except zmq.Again:
                return False
            if self._take(frame):
                return True

    def _take(self, frame: bytes) -> bool:
        header = self._header
        if len(frame) == header:
            self._connect()  # woken: the publishers have changed
            return False
        try:
            version, schema, incarnation, sequence, stamp, _ = self._unpack(frame, header)
        except StructError:
            self.rejected += 1
            return False
        if version != wire.VERSION or (schema not in self._codecs and not self._learn(schema)):
            self._reject(version, schema)
            return False
        if self._keep_all:
            last = self._last.get(incarnation)
            if last is not None and sequence > last + 1:
                self.drops += sequence - last - 1
            self._last[incarnation] = sequence
        self.bytes_received += len(frame)
        self._waiting.append((stamp, sequence, frame))
        return True

    def _next(self) -> Received[M] | None:
        while self._waiting or self._pump():
            received = self._decode(self._waiting.popleft())
            if received is not None:
                return received
        return None

    def _decode(self, item: tuple[int, int, bytes]) -> Received[M] | None:
        stamp, sequence, frame = item
        header, start = self._header, self._payload
        end = start + frame[start - 1]
        try:
            message = self._codecs[frame[header + 1 : header + 9]].decode(memoryview(frame)[end:])
            origin = frame[start:end].decode()
        except (ValueError, msgspec.DecodeError, RecursionError):  # ValueError: also of text and of arrays
            self.rejected += 1
            return None
        return Received(message, stamp, sequence, origin)

    def _learn(self, schema: bytes) -> bool:
        """Make a codec for a type of which only the schema is known; False when this subscriber wants its own type."""
        if self._codec is not None:
            return False
        known = self._node.discovery.schema(schema.hex())
        if known is None:
            return False
        try:
            self._codecs[schema] = codec(type_from_schema(known))
        except SchemaError as error:
            _log.warning("%s: %s", self.topic, error)
            return False
        return True

    def _reject(self, version: int, schema: bytes) -> None:
        self.rejected += 1
        if schema not in self._warned and len(self._warned) < _WARNINGS:
            self._warned.add(schema)
            _log.warning("%s: refused messages of version %d, schema %s", self.topic, version, schema.hex())

    # --- connecting -----------------------------------------------------------------------------------------------

    def _suits(self, entry: Entry) -> bool:
        return self._codec is None or entry.hashes == (self._codec.hash.hex(),)

    def _mismatch(self, node: str, types: tuple[str, ...], hashes: tuple[str, ...]) -> SchemaError:
        assert self._codec is not None
        return SchemaError(
            f"{self.topic}: {node} publishes {', '.join(types)} ({', '.join(hashes)}), "
            f"{self._node.name} expects {self._codec.name} ({self._codec.hash.hex()})"
        )

    def _connect(self) -> None:
        """Connect to the topic's publishers as they are now, and disconnect from those that are gone."""
        wanted = set()
        for peer in self._watch.peers:
            endpoint = peer.entry.endpoint
            if self._suits(peer.entry):
                wanted.add(endpoint)
            elif endpoint not in self._warned and len(self._warned) < _WARNINGS:
                self._warned.add(endpoint)
                _log.warning("%s", self._mismatch(peer.node, peer.entry.types, peer.entry.hashes))
        for endpoint in wanted - self._connected:
            try:
                self.socket.connect(endpoint)
            except zmq.ZMQError as error:  # a member has registered what is no address: not our end
                _log.warning("%s: cannot connect to %r: %s", self.topic, endpoint, error.strerror)
        for endpoint in self._connected - wanted:
            with contextlib.suppress(zmq.ZMQError):
                self.socket.disconnect(endpoint)
        self._connected = wanted


AnySubscriber = Subscriber[Message]
