"""Bifrost side of the recorder: every topic of the table, as ROS mirror types under ``/bifrost``."""

import logging
import struct
from collections.abc import Callable, Sequence
from typing import Any, cast

import bifrost
from bifrost import Message, Received, codec
from valor.bag_recorder.bag import SHARE, RecordedTopic, Sink
from valor.bag_recorder.clock import StampConverter
from valor.bags.selection import EVERYTHING, Selection
from valor.common.messages import MotionState
from valor.common.topics import MOTION_STATE, TOPICS, Topic
from valor.ros.definitions import definition, type_hash

PREFIX = "/bifrost/"
QUEUE = 4000  # messages per topic: eight seconds at 500 Hz while the recorder is delayed

_log = logging.getLogger("bag_recorder")


class _Tap:
    """Subscription of one topic."""

    def __init__(self, node: bifrost.Node, topic: Topic[Any]) -> None:
        self.topic = topic
        self.subscriber = topic.subscriber(node, queue=QUEUE, limited=False)
        self.every = topic.record_every
        self.encode = TwinEncoder(topic.type).encode
        name = twin_type(topic.type)
        self.recorded = RecordedTopic(PREFIX + topic.name, name, definition(name), type_hash=type_hash(name))
        self.received = self.unwritten = 0
        self.unfit = 0  # messages that cannot be encoded: an integer exceeds 64 signed bits

    @property
    def dropped(self) -> int:
        """Messages lost in transit, rejected, not convertible, or received while no bag could be written."""
        return self.subscriber.drops + self.subscriber.rejected + self.unfit + self.unwritten


class BifrostTap:
    """Subscribes to every recorded topic, and passes messages to a sink."""

    def __init__(
        self,
        node: bifrost.Node,
        clock: StampConverter,
        topics: Sequence[Topic[Any]] = TOPICS,
        selection: Selection = EVERYTHING,
        alive: Callable[[], None] = lambda: None,
    ) -> None:
        """Subscribe to the selected topics; ``alive``: watchdog, called repeatedly during long work."""
        self._offset, self._alive = clock.offset, alive
        self.state: bifrost.Received[MotionState] | None = None  # latest, if it is recorded and has arrived
        self._taps = [
            _Tap(node, topic) for topic in topics if topic.record_every > 0 and PREFIX + topic.name in selection
        ]

    @property
    def subscribers(self) -> dict[Topic[Any], bifrost.Subscriber[Any]]:
        return {tap.topic: tap.subscriber for tap in self._taps}

    @property
    def time(self) -> int:
        """Robot time of the latest state of the Motion Manager [ns]."""
        return self.state.message.time if self.state is not None else 0

    @property
    def counts(self) -> dict[str, tuple[int, int]]:
        return {tap.recorded.name: (tap.received, tap.dropped) for tap in self._taps}

    def drain(self, sink: Sink | None) -> None:
        """Pass the waiting messages to a sink, stamped with their publication; without a sink, count them dropped."""
        for tap in self._taps:
            for _ in range(QUEUE // SHARE):  # bounded, so that one fast topic does not block the others
                waiting = tap.subscriber.drain(most=SHARE)
                self._take(tap, waiting, sink)
                self._alive()
                if len(waiting) < SHARE:
                    break

    def _take(self, tap: _Tap, waiting: list[bifrost.Received[Any]], sink: Sink | None) -> None:
        tap.received += len(waiting)
        if waiting and tap.topic == MOTION_STATE:
            self.state = cast("bifrost.Received[MotionState]", waiting[-1])
        if sink is None:
            tap.unwritten += len(waiting)
            return
        for received in waiting:
            sequence = received.sequence
            if tap.every > 1 and sequence % tap.every:
                continue
            stamp = received.stamp + self._offset
            try:
                data = tap.encode(received, stamp)
            except struct.error as error:
                tap.unfit += 1
                if tap.unfit == 1:
                    _log.warning("%s: not recorded: %s", tap.recorded.name, error)
                continue
            sink.write(tap.recorded, stamp, stamp, sequence, data)


PACKAGE = "valor_msgs"
_ENCAPSULATION = b"\x00\x01\x00\x00"  # CDR, little-endian, no options
_SECOND = 1_000_000_000


_NUMBERS = {"bool": ("?", 1), "int": ("q", 8), "float": ("d", 8)}  # code in a format, and size [B], by schema type
_ARRAYS = {"uint8[]": 1, "float64[]": 8}  # size of an element [B]
_STRING, _STRINGS = "str", "list<str>"


def twin_type(message_type: type[Message]) -> str:
    """Name of the ROS mirror type, such as ``valor_msgs/msg/Motor``."""
    return f"{PACKAGE}/msg/{message_type.__name__}"


class TwinEncoder:
    """Encoder of one Bifrost type as CDR of its ROS mirror type; raises ``TypeError`` for a field without equivalent.

    A mirror type is ``std_msgs/Header header``, ``uint64 bifrost_sequence``, then the fields of the Bifrost message.
    CDR (OMG XCDR version 1, little-endian) aligns every number to its size, counted from the end of the encapsulation.
    The padding depends only on the lengths of strings and arrays: one ``struct.Struct`` per combination of lengths
    packs a complete message; a topic has few combinations.
    """

    LAYOUTS = 256  # stored; free text has many lengths

    def __init__(self, message_type: type[Message]) -> None:
        fields = codec(message_type).schema.types[message_type.__name__]
        for name, kind in fields:
            if kind not in {*_NUMBERS, *_ARRAYS, _STRING, _STRINGS}:
                raise TypeError(f"{message_type.__name__}.{name}: {kind} has no ROS equivalent")
        self._fields = tuple(fields)
        self._pack: dict[tuple[int, ...], Callable[..., bytes]] = {}

    def encode(self, received: Received[Any], stamp: int) -> bytes:
        """Encode a message, with encapsulation; raises ``struct.error`` if an integer exceeds 64 signed bits.

        ``stamp``: time of publication, wall clock [ns].
        """
        origin = received.origin.encode()
        lengths = [len(origin)]
        packed: list[Any] = [_ENCAPSULATION, *divmod(stamp, _SECOND), len(origin) + 1, origin, received.sequence]
        message = received.message
        for name, kind in self._fields:
            value = getattr(message, name)
            if kind in _NUMBERS:
                packed.append(value)
                continue
            if kind in _ARRAYS:
                lengths.append(len(value))
                packed += (len(value), value.tobytes())
                continue
            if kind == _STRINGS:
                lengths.append(len(value))
                packed.append(len(value))
            for each in value if kind == _STRINGS else (value,):
                text = each.encode()
                lengths.append(len(text))
                packed += (len(text) + 1, text)
        key = tuple(lengths)
        pack = self._pack.get(key)
        if pack is None:
            if len(self._pack) >= self.LAYOUTS:
                self._pack.clear()
            pack = self._pack[key] = struct.Struct(self._format(key)).pack
        return pack(*packed)

    def _format(self, lengths: tuple[int, ...]) -> str:
        """The ``struct`` format of a message with strings and arrays of these lengths."""
        layout = _Layout()
        remaining = iter(lengths)
        layout.number("i", 4)
        layout.number("I", 4)
        layout.string(next(remaining))
        layout.number("Q", 8)
        for _, kind in self._fields:
            if kind in _NUMBERS:
                layout.number(*_NUMBERS[kind])
            elif kind in _ARRAYS:
                layout.array(next(remaining), _ARRAYS[kind])
            elif kind == _STRING:
                layout.string(next(remaining))
            else:
                layout.number("I", 4)
                for _ in range(next(remaining)):
                    layout.string(next(remaining))
        return layout.format


class _Layout:
    """A ``struct`` format under construction, with CDR's padding."""

    def __init__(self) -> None:
        self.format = f"<{len(_ENCAPSULATION)}s"
        self._position = 0

    def number(self, code: str, size: int) -> None:
        self._align(size)
        self._append(code, size)

    def string(self, length: int) -> None:
        """Append the length including the terminating zero, the text, and the zero (which ``struct`` fills in)."""
        self.number("I", 4)
        self._append(f"{length + 1}s", length + 1)

    def array(self, length: int, size: int) -> None:
        """Append the length, then the elements; without elements there is no alignment."""
        self.number("I", 4)
        if length:
            self._align(size)
        self._append(f"{length * size}s", length * size)

    def _align(self, size: int) -> None:
        padding = -self._position % size
        if padding:
            self._append(f"{padding}x", padding)

    def _append(self, code: str, size: int) -> None:
        self.format += code
        self._position += size
