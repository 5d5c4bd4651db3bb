"""What comes in for one subscriber: its socket, connected to the topic's publishers, and all checks before decoding."""

from __future__ import annotations

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
from bifrost.limits import LOOKS, Limit, Meter, Muted, endpoint_of
from bifrost.reflection import type_from_schema

_log = logging.getLogger("bifrost")
_NOBLOCK = int(zmq.NOBLOCK)
_WARNINGS = 20  # a subscriber's, at most; the rest is counted
_PUBLISHERS = 1000  # whose last sequence is remembered
_FUTURE = 1_000_000  # a stamp this far ahead of the clock it was taken from is none [ns]
_QUICKEST = 100  # nobody publishes oftener than this [ns]; a gap that would take more is none
_GOES_ON = 100_000_000  # a message so long after one too many is of the same flood [ns]
_BURST = 1000  # ... but for so many messages, for clocks that stand still between two readings


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
        meter: of how much it sends; None: however much.
        clock: by which it stamps.
    """

    __slots__ = ("clock", "decode", "meter", "name", "origin", "payload", "prefix", "sequence", "stamp")

    def __init__(
        self, prefix: bytes, origin: bytes, decode: Callable[[bytes | memoryview], Any], meter: Meter | None = None
    ) -> None:
        self.prefix = prefix
        self.origin = origin
        self.name = origin[1:].decode()
        self.payload = len(prefix) + wire.PUBLICATION_VARIABLE.size + len(origin)
        self.decode = decode
        self.sequence = 0
        self.stamp = -(2**63)
        self.meter = meter
        self.clock = OWN_CLOCK


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
        left: whether the last look ended before all that waited had been looked at.
        floods: how often a publisher was muted.
    """

    def __init__(
        self, discovery: Discovery, topic: str, own_codec: Codec[Any] | None, queue: int | None, limit: Limit | None
    ) -> None:
        self.several = self.left = False
        self.floods = 0
        self._limit = limit
        self._muted = Muted()
        self._trace = False  # somebody is to be muted: where do its messages come from?
        self._flooding, self._flooded_at = _NOBODY, 0
        self.messages = self.drops = self.rejected = self.bytes_received = 0
        self._discovery = discovery
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
        self._clocks: dict[str, OtherClock] = {}  # by which nodes stamp, by their names
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
        discovery.connect_wake(self.socket)
        self._connect()

    @property
    def pollable(self) -> zmq.Socket[bytes] | int:
        """For polling."""
        return self.socket

    @property
    def sequence(self) -> int:
        """Of the newest message let through, by its publisher's count; 0: none yet."""
        return self._stream.sequence

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

    @property
    def muted(self) -> tuple[str, ...]:
        """Names of the nodes that are muted now."""
        endpoints = self._muted.endpoints()
        return tuple(peer.node for peer in self._watch.peers if peer.entry.endpoint in endpoints) if endpoints else ()

    def within(self, milliseconds: int) -> Checked | None:
        """Block until something arrives, or for ever if negative; None after that time, or if it was no message."""
        if milliseconds != self._timeout:
            self.socket.setsockopt(zmq.RCVTIMEO, milliseconds)
            self._timeout = milliseconds
        try:
            return self._take_traced(0) if self._trace else self._take(self._recv())
        except zmq.Again:
            return None

    def now(self) -> Checked | None:
        """A message if there is one; None also after many that were refused."""
        self.left = False
        for _ in range(LOOKS):
            try:
                checked = self._take_traced() if self._trace else self._take(self._recv(_NOBLOCK))
            except zmq.Again:
                return None
            if checked is not None:
                return checked
        self.left = True
        return None

    def close(self) -> None:
        """Close the socket."""
        self._discovery.unwatch(self._watch)
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
        if stream.meter is not None and stream.meter.exceeds(sequence - last if last else 1, stamp):
            self._trace, self._flooding, self._flooded_at = True, stream, now  # it is muted with its next message
        stream.sequence, stream.stamp = sequence, stamp
        self.messages += 1
        self.bytes_received += len(frame)
        return stamp - stream.clock.ahead, sequence, frame, stream, now

    def _take_traced(self, flags: int = _NOBLOCK) -> Checked | None:
        """As ``_take``; mutes the publisher, if it is the one that has sent too much."""
        frame = self.socket.recv(flags, copy=False)
        content = frame.bytes
        checked = self._take(content)
        if content.startswith(self._flooding.prefix):
            self._trace = False
            goes_on = monotonic_ns() - self._flooded_at < _GOES_ON
            if goes_on and (endpoint := endpoint_of(frame, self._connected)):
                self._mute(endpoint)
        return checked

    def _mute(self, endpoint: str) -> None:
        """Disconnect from a publisher for a while: what it sends then is dropped where it is."""
        self.floods += 1
        self._muted.add(endpoint)
        name = next((peer.node for peer in self._watch.peers if peer.entry.endpoint == endpoint), endpoint)
        self._warn(f"flood {endpoint}", f"{self._topic}: {name} floods it, and is muted while it goes on")
        self._connect()
        self._discovery.wake_at(self._topic, self._muted.ends)

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
            meter = None if self._limit is None else Meter(self._limit)
            stream = Stream(frame[: self._variable], origin, self._codecs[schema].decode, meter)
        except UnicodeDecodeError:
            self._reject("an origin that is no text")
            return None
        if len(origin) != 1 + length:
            self._reject("an origin longer than the message")
            return None
        stream.clock = self._clocks.get(stream.name, OWN_CLOCK)
        if len(self._streams) >= _PUBLISHERS:
            del self._streams[next(iter(self._streams))]
        self._streams[stream.prefix] = stream
        return stream

    def _learn(self, schema: bytes) -> bool:
        """Make a codec for a type of which only the schema is known; False when this subscriber wants its own type."""
        if self._codec is not None:
            return False
        known = self._discovery.schema(schema.hex())
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
            f"{self._discovery.name} expects {self._codec.name} ({self._codec.hash.hex()})"
        )

    def _connect(self) -> None:
        """Connect to the topic's publishers as they are now, and disconnect from those that are gone."""
        wanted: dict[str, Entry] = {}
        one_clock = True
        self._clocks.clear()
        for peer in self._watch.peers:
            endpoint = peer.entry.endpoint
            if self._suits(peer.entry):
                wanted[endpoint] = peer.entry
                one_clock &= peer.computer == self._discovery.network.computer.name
                self._clocks[peer.node] = self._discovery.clock(peer.computer)
            else:
                self._warn(endpoint, str(self._mismatch(peer.node, peer.entry.types, peer.entry.hashes)))
        for endpoint in self._muted.endpoints():
            wanted.pop(endpoint, None)
        for endpoint in wanted.keys() - self._connected:
            try:
                self._discovery.connect(self.socket, wanted[endpoint])
            except zmq.ZMQError as error:  # a member has registered what is no address: not our end
                _log.warning("%s: cannot connect to %r: %s", self._topic, endpoint, error.strerror)
        for endpoint in self._connected - wanted.keys():
            with contextlib.suppress(zmq.ZMQError):
                self.socket.disconnect(endpoint)
        self._connected = set(wanted)
        self._one_clock = one_clock
        self.several = len(wanted) > 1
