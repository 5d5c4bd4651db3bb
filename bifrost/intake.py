"""What comes in for one subscriber: its socket, connected to the topic's publishers, and all checks before decoding."""

from __future__ import annotations

import contextlib
import logging
import os
import select
import threading
from collections import deque
from collections.abc import Callable
from struct import error as StructError  # noqa: N812
from time import monotonic_ns
from typing import TYPE_CHECKING, Any

import zmq

from bifrost import wire
from bifrost.directory import Entry
from bifrost.encoding import Codec, codec
from bifrost.errors import SchemaError
from bifrost.schema import type_from_schema

if TYPE_CHECKING:
    from bifrost.node import Node

_log = logging.getLogger("bifrost")
_NOBLOCK = int(zmq.NOBLOCK)
_WARNINGS = 20  # a subscriber's, at most; the rest is counted
_PUBLISHERS = 1000  # whose last sequence is remembered
_FUTURE = 1_000_000  # a stamp this far ahead of the clock it was taken from is none [ns]
_QUICKEST = 100  # nobody publishes oftener than this [ns]; a gap that would take more is none
_BURST = 1000  # ... but for so many messages, for clocks that stand still between two readings
_LOOK = 1000  # a reservoir looks whether it is closed at least this often [ms]


class Stream:
    """What is known of one publisher, so that its next message is checked by comparing bytes.

    Attributes:
        prefix: with which its messages begin: topic, version, schema, incarnation.
        origin: the length and name of its node, as they follow its sequence and stamp.
        name: of its node.
        payload: where the payload begins [B].
        decode: that.
        sequence: of the last message; 0 before the first.
        stamp: of the last message [ns].
    """

    __slots__ = ("decode", "name", "origin", "payload", "prefix", "sequence", "stamp")

    def __init__(self, prefix: bytes, origin: bytes, decode: Callable[[bytes | memoryview], Any]) -> None:
        self.prefix = prefix
        self.origin = origin
        self.name = origin[1:].decode()
        self.payload = len(prefix) + wire.PUBLICATION_VARIABLE.size + len(origin)
        self.decode = decode
        self.sequence = 0
        self.stamp = -(2**63)


Checked = tuple[int, int, bytes, Stream, int]  # stamp, sequence, frame, its publisher, when it was taken in [ns]
_NOBODY = Stream(b"\0", b"\0", lambda _: None)  # no topic begins so


class Intake:
    """The socket of one subscriber.

    Attributes:
        socket: SUB.
        several: whether it is connected to more than one publisher.
        messages: let through.
        drops: known lost by gaps in the sequence.
        rejected: refused.
        bytes_received: of the messages let through, envelopes included [B].
    """

    def __init__(self, node: Node, topic: str, own_codec: Codec[Any] | None, queue: int | None) -> None:
        self.several = False
        self.messages = self.drops = self.rejected = self.bytes_received = 0
        self._node = node
        self._topic = topic
        self._codec = own_codec
        self._codecs: dict[bytes, Codec[Any]] = {} if own_codec is None else {own_codec.hash: own_codec}
        self._keep_all = queue is not None
        self._prefix = topic.encode() + b"\0"
        self._header = len(self._prefix)
        self._variable = self._header + wire.PUBLICATION_CONSTANT.size
        self._length = self._variable + wire.PUBLICATION_VARIABLE.size
        self._unpack = wire.PUBLICATION_VARIABLE.unpack_from
        self._streams: dict[bytes, Stream] = {}  # by prefix
        self._stream = _NOBODY  # of the publisher heard last
        self._one_clock = True
        self._connected: set[str] = set()
        self._warned: set[bytes | str] = set()
        self._timeout = -2
        self.socket = node.connecting_socket(zmq.SUB)
        self._watch = node.discovery.watch("publisher", topic)
        if queue is None:
            self.socket.setsockopt(zmq.CONFLATE, 1)
        else:
            self.socket.setsockopt(zmq.RCVHWM, queue)
        self.socket.setsockopt(zmq.SUBSCRIBE, self._prefix)
        self._recv = self.socket.recv
        node.connect_wake(self.socket)
        self._connect()

    @property
    def pollable(self) -> zmq.Socket[bytes] | int:
        """For polling."""
        return self.socket

    @property
    def publishers(self) -> tuple[str, ...]:
        """Names of the nodes that it is connected to, without those that are known to be gone."""
        return tuple(peer.node for peer in self._watch.peers if peer.alive and peer.entry.endpoint in self._connected)

    @property
    def mismatches(self) -> list[SchemaError]:
        """One error for every publisher of another type."""
        return [
            self._mismatch(peer.node, peer.entry.types, peer.entry.hashes)
            for peer in self._watch.peers
            if not self._suits(peer.entry)
        ]

    def within(self, milliseconds: int) -> Checked | None:
        """Block until something arrives, or for ever if negative; None after that time, or if it was no message."""
        if milliseconds != self._timeout:
            self.socket.setsockopt(zmq.RCVTIMEO, milliseconds)
            self._timeout = milliseconds
        try:
            frame = self._recv()
        except zmq.Again:
            return None
        return self._take(frame)

    def now(self) -> Checked | None:
        """A message if there is one."""
        while True:
            try:
                frame = self._recv(_NOBLOCK)
            except zmq.Again:
                return None
            checked = self._take(frame)
            if checked is not None:
                return checked

    def close(self) -> None:
        """Close the socket."""
        self._node.discovery.unwatch(self._watch)
        self.socket.close()

    # --- checking -------------------------------------------------------------------------------------------------

    def _take(self, frame: bytes) -> Checked | None:
        # The common case, once more from the same publisher, in few steps: in a control loop each of them finds the
        # processor's caches cold.
        stream, latched = self._stream, False
        if not frame.startswith(stream.prefix):
            if len(frame) == self._header:
                self._connect()  # woken: the publishers have changed
                return None
            latched = frame.startswith(wire.LATCHED, self._header)
            if latched:
                frame = frame[: self._header] + frame[self._header + 1 :]
            found = self._streams.get(frame[: self._variable]) or self._new_stream(frame)
            if found is None:
                return None
            stream = self._stream = found
        try:
            sequence, stamp = self._unpack(frame, self._variable)
        except StructError:
            self._reject("a length that is too short")
            return None
        last = stream.sequence
        if sequence != last + 1:
            if sequence <= last:
                if not latched:  # else it has come back, and has had the message already
                    self._reject("a sequence that goes backwards")
                return None
            if last and sequence - last > (stamp - stream.stamp) // _QUICKEST + _BURST:
                self._reject("a sequence that is too far ahead")
                return None
        now = monotonic_ns()
        if stamp < stream.stamp or (self._one_clock and stamp > now + _FUTURE):
            self._reject("a stamp older than the one before, or of the future")
            return None
        if not frame.startswith(stream.origin, self._length):
            self._reject("an origin that is not its publisher's")
            return None
        if last and self._keep_all:
            self.drops += sequence - last - 1
        stream.sequence, stream.stamp = sequence, stamp
        self.messages += 1
        self.bytes_received += len(frame)
        return stamp, sequence, frame, stream, now

    def _new_stream(self, frame: bytes) -> Stream | None:
        """The first message of a publisher: what its next ones are compared with; None if this is no message."""
        try:
            version, schema, _, _, _, length = wire.PUBLICATION.unpack_from(frame, self._header)
        except StructError:
            self._reject("a length that is too short")
            return None
        if version != wire.VERSION or (schema not in self._codecs and not self._learn(schema)):
            self._reject(f"version {version}, schema {schema.hex()}")
            return None
        origin = frame[self._length : self._length + 1 + length]
        try:
            stream = Stream(frame[: self._variable], origin, self._codecs[schema].decode)
        except UnicodeDecodeError:
            self._reject("an origin that is no text")
            return None
        if len(origin) != 1 + length:
            self._reject("an origin longer than the message")
            return None
        if len(self._streams) >= _PUBLISHERS:
            del self._streams[next(iter(self._streams))]
        self._streams[stream.prefix] = stream
        return stream

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
            _log.warning("%s: %s", self._topic, error)
            return False
        return True

    def _reject(self, what: str) -> None:
        """Count a message that is refused; the log says it once."""
        self.rejected += 1
        self._warn(what, f"{self._topic}: refused messages of {what}")

    def _warn(self, about: str, text: str) -> None:
        if about not in self._warned and len(self._warned) < _WARNINGS:
            self._warned.add(about)
            _log.warning("%s", text)

    # --- connecting -----------------------------------------------------------------------------------------------

    def _suits(self, entry: Entry) -> bool:
        return self._codec is None or entry.hashes == (self._codec.hash.hex(),)

    def _mismatch(self, node: str, types: tuple[str, ...], hashes: tuple[str, ...]) -> SchemaError:
        assert self._codec is not None
        return SchemaError(
            f"{self._topic}: {node} publishes {', '.join(types)} ({', '.join(hashes)}), "
            f"{self._node.name} expects {self._codec.name} ({self._codec.hash.hex()})"
        )

    def _connect(self) -> None:
        """Connect to the topic's publishers as they are now, and disconnect from those that are gone."""
        wanted = set()
        one_clock = True
        for peer in self._watch.peers:
            endpoint = peer.entry.endpoint
            if self._suits(peer.entry):
                wanted.add(endpoint)
                one_clock &= peer.computer == self._node.network.computer.name
            else:
                self._warn(endpoint, str(self._mismatch(peer.node, peer.entry.types, peer.entry.hashes)))
        for endpoint in wanted - self._connected:
            try:
                self.socket.connect(endpoint)
            except zmq.ZMQError as error:  # a member has registered what is no address: not our end
                _log.warning("%s: cannot connect to %r: %s", self._topic, endpoint, error.strerror)
        for endpoint in self._connected - wanted:
            with contextlib.suppress(zmq.ZMQError):
                self.socket.disconnect(endpoint)
        self._connected = wanted
        self._one_clock = one_clock
        self.several = len(wanted) > 1


class Reservoir:
    """Messages that a thread takes in at once and holds up to a depth; of more, the oldest are dropped."""

    def __init__(self, intake: Intake, depth: int, name: str) -> None:
        self.evicted = 0
        self._intake = intake
        self._depth = depth
        self._held: deque[Checked] = deque()
        self._lock = threading.Lock()
        self._filled = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)  # readable while anything is held, or nudged
        self._nudged = False
        self._poll = select.poll()
        self._poll.register(self._filled, select.POLLIN)
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def several(self) -> bool:
        """Never asked to look for the newest."""
        return False

    @property
    def pollable(self) -> int:
        """For polling."""
        return self._filled

    def within(self, milliseconds: int) -> Checked | None:
        """The oldest message held; waits for one, for ever if negative."""
        checked = self.now()
        if checked is None and self._poll.poll(milliseconds):
            checked = self.now()
        return checked

    def now(self) -> Checked | None:
        """The oldest message held, if any."""
        with self._lock:
            checked = self._held.popleft() if self._held else None
            if not self._held and (checked is not None or self._nudged):
                self._nudged = False
                os.eventfd_read(self._filled)
            return checked

    def wake(self) -> None:
        """Make ``within`` return, if it waits. From any thread."""
        with self._lock:
            if not (self._closing or self._nudged):
                self._nudged = True
                os.eventfd_write(self._filled, 1)

    def close(self) -> None:
        """End the thread and close the socket. It must be woken by whoever calls."""
        with self._lock:
            self._closing = True
        self._thread.join()
        os.close(self._filled)

    def _run(self) -> None:
        while not self._closing:
            checked = self._intake.within(_LOOK)
            if checked is None:
                continue
            with self._lock:
                if len(self._held) >= self._depth:
                    self._held.popleft()
                    self.evicted += 1
                elif not self._held:
                    os.eventfd_write(self._filled, 1)
                self._held.append(checked)
        self._intake.close()
