"""A subscriber's socket, connected to the topic's publishers, and all checks before decoding."""

import contextlib
import logging
from collections.abc import Callable
from struct import error as StructError  # noqa: N812
from time import monotonic_ns
from typing import Any

import zmq

from bifrost import wire
from bifrost.clocks import OWN_CLOCK, OtherClock
from bifrost.directory import Entry
from bifrost.discovery import Discovery
from bifrost.encoding import Codec, codec
from bifrost.errors import SchemaError
from bifrost.limits import LOOKS, Limit, Meter
from bifrost.reflection import type_from_schema

_log = logging.getLogger("bifrost")
_NOBLOCK = int(zmq.NOBLOCK)
_WARNINGS = 20  # maximum number of logged warnings of a subscriber
_PUBLISHERS = 1000  # maximum number of publishers whose last sequence is stored
_FUTURE = 1_000_000  # maximum of a stamp ahead of its clock [ns]
_QUICKEST = 100  # minimum period of a publisher; a gap that would need less is impossible [ns]
_BURST = 1000  # messages exempt from _QUICKEST, for clocks of low resolution


class Stream:
    """State of one publisher; its next message is checked by comparison of bytes."""

    __slots__ = ("clock", "decode", "meter", "name", "origin", "payload", "prefix", "sequence", "stamp")

    def __init__(self, prefix: bytes, origin: bytes, decode: Callable[[bytes | memoryview], Any]) -> None:
        self.prefix = prefix  # start of its messages: topic, version, schema, incarnation
        self.origin = origin  # length and name of its node, which follow sequence and stamp
        self.name = origin[1:].decode()
        self.payload = len(prefix) + wire.PUBLICATION_VARIABLE.size + len(origin)  # offset [B]
        self.decode = decode
        self.sequence = 0  # of the last message; 0 before the first
        self.stamp = -(2**63)  # of the last message [ns]
        self.meter: Meter | None = None  # of its rate; None: no limit
        self.clock = OWN_CLOCK  # of its stamps


Checked = tuple[int, int, bytes, Stream, int]  # stamp, sequence, frame, publisher, time of receipt [ns]
_NOBODY = Stream(b"\0", b"\0", lambda _: None)  # matches no topic


class Intake:
    """Base of a subscriber."""

    def __init__(
        self, discovery: Discovery, topic: str, own_codec: Codec[Any] | None, queue: int | None, limit: Limit | None
    ) -> None:
        self.several = self._more = False  # connected to several publishers
        self._limit = limit
        self.drops = 0  # messages lost since start: gaps in the sequence (with a queue), and of muted publishers
        self.rejected = 0  # since start: another schema, not decodable, or an impossible sequence or stamp
        self._discovery = discovery
        self.topic = topic
        self._codec = own_codec
        self._codecs: dict[bytes, Codec[Any]] = {} if own_codec is None else {own_codec.hash: own_codec}
        self._keep_all = queue is not None
        self._prefix = topic.encode() + b"\0"
        self._header = len(self._prefix)
        self._variable = self._header + wire.PUBLICATION_CONSTANT.size
        self._length = self._variable + wire.PUBLICATION_VARIABLE.size
        self._unpack = wire.PUBLICATION_VARIABLE.unpack_from
        self._streams: dict[bytes, Stream] = {}  # by prefix
        self._stream = _NOBODY  # publisher of the last message
        self._one_clock = True
        self._clocks: dict[str, OtherClock] = {}  # of the stamps, by name of the node
        self._connected: set[str] = set()
        self._warned: set[bytes | str] = set()
        self._timeout = -2
        self.socket = discovery.connecting_socket(zmq.SUB)
        self._watch = discovery.watch("publisher", topic)
        if queue is None:
            self.socket.setsockopt(zmq.CONFLATE, 1)
        else:
            self.socket.setsockopt(zmq.RCVHWM, queue)
        self.socket.setsockopt(zmq.SUBSCRIBE, self._prefix)
        self._recv = self.socket.recv
        discovery.wakes.connect(self.socket)
        self._connect()

    @property
    def sequence(self) -> int:
        """Sequence of the latest accepted message, as its publisher counts; 0: none yet."""
        return self._stream.sequence

    @property
    def publishers(self) -> tuple[str, ...]:
        """Names of the connected nodes, without those known to have ended."""
        return tuple(peer.node for peer in self._watch.peers if peer.alive and peer.entry.endpoint in self._connected)

    @property
    def muted(self) -> tuple[str, ...]:
        """Names of the nodes that exceed the limit, and are not received at present."""
        now = monotonic_ns()
        meters = [stream.meter for stream in self._streams.values() if stream.meter is not None]
        return tuple(sorted({meter.name for meter in meters if meter.muted_until > now}))

    def _within(self, milliseconds: int) -> Checked | None:
        """Wait for a message, without limit if negative; None after the timeout, a wake or a rejected message."""
        if milliseconds != self._timeout:
            self.socket.setsockopt(zmq.RCVTIMEO, milliseconds)
            self._timeout = milliseconds
        try:
            return self._take(self._recv())
        except zmq.Again:
            return None

    def _now(self) -> Checked | None:
        """A waiting message, or None; None also after many rejected ones."""
        self._more = False
        for _ in range(LOOKS):
            try:
                checked = self._take(self._recv(_NOBLOCK))
            except zmq.Again:
                return None
            if checked is not None:
                return checked
        self._more = True
        return None

    def _take(self, frame: bytes) -> Checked | None:
        # Few steps in the common case, a message of the same publisher: in a control loop the caches are cold.
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
                if not latched:  # after a reconnection, the latched message is a repetition
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
        if stream.meter is not None and stream.meter.mutes(sequence - last if last else 1, stamp, now):
            self.drops += 1
            return None
        return stamp - stream.clock.ahead, sequence, frame, stream, now

    def _new_stream(self, frame: bytes) -> Stream | None:
        """State of a publisher from its first message; None if the message is invalid."""
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
            self._reject("an origin that is not text")
            return None
        if len(origin) != 1 + length:
            self._reject("an origin longer than the message")
            return None
        stream.clock = self._clocks.get(stream.name, OWN_CLOCK)
        stream.meter = None if self._limit is None else Meter(self._limit, self.topic, stream.name)
        if len(self._streams) >= _PUBLISHERS:
            del self._streams[next(iter(self._streams))]
        self._streams[stream.prefix] = stream
        return stream

    def _learn(self, schema: bytes) -> bool:
        """Make a codec from a registered schema; False if this subscriber has a fixed type, or no schema is known."""
        if self._codec is not None:
            return False
        known = self._discovery.schema(schema.hex())
        if known is None:
            return False
        try:
            self._codecs[schema] = codec(type_from_schema(known))
        except SchemaError as error:
            _log.warning("%s: %s", self.topic, error)
            return False
        return True

    def _reject(self, what: str) -> None:
        """Count a rejected message; log each reason once."""
        self.rejected += 1
        self._warn(what, f"{self.topic}: rejected messages with {what}")

    def _warn(self, about: str, text: str) -> None:
        if about not in self._warned and len(self._warned) < _WARNINGS:
            self._warned.add(about)
            _log.warning("%s", text)

    def _connect(self) -> None:
        """Connect to the topic's present publishers, and disconnect from the others."""
        wanted: dict[str, Entry] = {}
        one_clock = True
        self._clocks.clear()
        for peer in self._watch.peers:
            endpoint, types, hashes = peer.entry.endpoint, peer.entry.types, peer.entry.hashes
            if self._codec is not None and hashes != (self._codec.hash.hex(),):
                text = f"{self.topic}: {peer.node} publishes {', '.join(types)} ({', '.join(hashes)}), "
                text += f"{self._discovery.name} expects {self._codec.name} ({self._codec.hash.hex()}): not connected"
                self._warn(endpoint, text)
                continue
            wanted[endpoint] = peer.entry
            one_clock &= peer.computer == self._discovery.network.computer.name
            self._clocks[peer.node] = self._discovery.clock(peer.computer)
        for endpoint in wanted.keys() - self._connected:
            try:
                self._discovery.connect(self.socket, wanted[endpoint])
            except zmq.ZMQError as error:  # a member has registered an invalid address
                _log.warning("%s: cannot connect to %r: %s", self.topic, endpoint, error.strerror)
        for endpoint in self._connected - wanted.keys():
            with contextlib.suppress(zmq.ZMQError):
                self.socket.disconnect(endpoint)
        self._connected = set(wanted)
        self._one_clock = one_clock
        self.several = len(wanted) > 1
