"""Subscribing: one socket a subscriber, so that depth and pace are its own."""

from __future__ import annotations

import time
from collections import deque
from typing import Any, Generic, Literal

import msgspec
import zmq

from bifrost.directory import Entry
from bifrost.discovery import Discovery
from bifrost.encoding import Codec, codec
from bifrost.errors import SchemaError
from bifrost.intake import Checked, Intake
from bifrost.limits import LOOKS, Limit
from bifrost.messages import M
from bifrost.reservoir import Reservoir
from bifrost.waiting import Waitable

Drop = Literal["newest", "oldest"]
_SMALL = 4096  # copying fewer bytes than this is quicker than a view of them [B]
_LARGEST = 2**63 - 1  # a count that a member has blown up is told as this


class Received(msgspec.Struct, Generic[M], gc=False, eq=False):
    """A message and its envelope.

    Attributes:
        message: decoded; its arrays are read-only.
        stamp: when it was published, by the own monotonic clock [ns]; from another computer as well as its clock is
            known (``bifrost.clocks``), and as that has it until it is.
        sequence: the publisher's count, from 1.
        origin: name of the node that published it.
        arrived: when it was taken from the network, before it was decoded, by the own monotonic clock [ns].
    """

    message: M
    stamp: int
    sequence: int
    origin: str
    arrived: int = 0


class Subscriber(Waitable, Generic[M]):
    """Receives the messages of one topic. Made by ``Node.subscriber``."""

    def __init__(
        self,
        discovery: Discovery,
        topic: str,
        message_type: type[M] | None,
        queue: int | None,
        drop: Drop = "newest",
        *,
        limit: Limit | None = None,
    ) -> None:
        self.topic = topic
        self._discovery = discovery
        own: Codec[Any] | None = None if message_type is None else codec(message_type)
        self._keep_all = queue is not None
        self._waiting: deque[Checked] = deque()  # checked but not delivered
        self._undecodable = 0
        self._woken = False
        self._closed = False
        self._full = False  # the last look took as many as it was to
        intake = self._intake = Intake(discovery, topic, own, queue, limit)
        self._reservoir: Reservoir[Checked] | None = None
        if queue and drop == "oldest":
            self._reservoir = Reservoir(intake.within, intake.close, queue, f"{topic} to {discovery.name}")
        self._source: Intake | Reservoir[Checked] = self._reservoir or intake
        types, hashes, schemas = ((), (), ()) if own is None else ((own.name,), (own.hash.hex(),), (own.schema,))
        self._key = discovery.announce(Entry("subscriber", topic, types, hashes), schemas, self, self._counts)

    # --- for the user ---------------------------------------------------------------------------------------------

    @property
    def drops(self) -> int:
        """Messages known lost since start: by gaps in the sequence, or dropped as the oldest.

        A latest-value subscriber loses none: what newer messages replace is not counted.
        """
        return self._intake.drops + (self._reservoir.evicted if self._reservoir else 0)

    @property
    def rejected(self) -> int:
        """Messages refused since start: of another schema, not decodable, with a sequence or stamp that cannot be."""
        return self._intake.rejected + self._undecodable

    @property
    def sequence(self) -> int:
        """Of the newest message taken in, by the count of the publisher heard last; 0: none yet."""
        return self._intake.sequence

    @property
    def bytes_received(self) -> int:
        """Of all messages since start, envelopes included, encryption not [B]."""
        return self._intake.bytes_received

    def latest(self) -> Received[M] | None:
        """The newest message not yet returned, or None; older ones are passed over. Never blocks."""
        while True:
            for _ in range(LOOKS):
                if not self._pump():
                    break
            else:
                self._full = True
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
            None after the time-out, or when woken.
        """
        if timeout is not None and timeout <= 0.0:
            # What is conflated on its way, of one publisher, is the newest already.
            return self._next() if self._keep_all or not (self._waiting or self._source.several) else self.latest()
        deadline = 0.0 if timeout is None else time.monotonic() + timeout
        milliseconds = -1 if timeout is None else int(timeout * 1000.0) + 1
        while True:
            if self._waiting:
                received = self._next() if self._keep_all else self.latest()
            else:
                # What waits is returned by the same call that would wait: one call into ZeroMQ a message.
                checked = self._source.within(milliseconds)
                received = None
                if checked is not None:
                    if self._keep_all or not self._source.several:
                        received = self._decode(checked)
                    else:  # each of several publishers has a newest message of its own
                        self._waiting.append(checked)
                        received = self.latest()
            if received is not None:
                return received
            if self._woken:
                self._woken = False
                return None
            if timeout is not None:
                remaining = deadline - time.monotonic()
                if remaining <= 0.0:
                    return None
                milliseconds = int(remaining * 1000.0) + 1

    def wake(self) -> None:
        """Make ``receive`` return now, if it waits, and else perhaps the next one. From any thread."""
        self._woken = True
        if self._reservoir is not None:
            self._reservoir.wake()
        else:
            self._discovery.wake(self.topic)

    def drain(self, most: int | None = None, within: float | None = None) -> list[Received[M]]:
        """All messages that wait, oldest first; of a latest-value subscriber at most one. Never blocks.

        Args:
            most: at most so many; the rest goes on waiting, see ``left``. Those of several publishers come in turn.
            within: begin with none after so long [s].
        """
        if not self._keep_all:
            received = self.latest()
            return [] if received is None else [received]
        messages: list[Received[M]] = []
        end = None if within is None else time.monotonic() + within
        while (received := self._next()) is not None:
            messages.append(received)
            if len(messages) == most or (end is not None and time.monotonic() >= end):
                self._full = True
                break
        return messages

    @property
    def left(self) -> bool:
        """Whether the last look may have left something waiting; a ``Poller`` tells of it again."""
        return self._full or self._intake.left

    @property
    def muted(self) -> tuple[str, ...]:
        """Names of the nodes that send more than the limit allows, and are not listened to now."""
        return self._intake.muted

    @property
    def floods(self) -> int:
        """How often a publisher was muted since start; what it published meanwhile is in ``drops``."""
        return self._intake.floods

    def fileno(self) -> int:
        """A descriptor for an event loop.

        It becomes readable when something *may* have come, and it tells so once: after it has, and after every call
        here, call ``drain`` or ``latest`` until nothing is left before waiting for it again.
        """
        pollable = self.pollable
        return pollable if isinstance(pollable, int) else int(pollable.getsockopt(zmq.FD))

    @property
    def pollable(self) -> zmq.Socket[bytes] | int:
        """For ``bifrost.wait`` and ZeroMQ's pollers."""
        return self._source.pollable

    @property
    def publishers(self) -> tuple[str, ...]:
        """Names of the nodes that it is connected to, without those that are known to be gone."""
        return self._intake.publishers

    @property
    def mismatches(self) -> list[SchemaError]:
        """One error for every publisher of the topic whose type is another: such are not listened to."""
        return self._intake.mismatches

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
            self._discovery.withdraw(self._key)
            if self._reservoir is not None:
                self._discovery.wake(self.topic)
            self._source.close()

    # --- receiving ------------------------------------------------------------------------------------------------

    def _counts(self) -> tuple[int, int, int]:
        return self._intake.messages, min(self.drops, _LARGEST), self.rejected

    def _pump(self) -> bool:
        """Take one message into ``_waiting``; False when there is none."""
        checked = self._source.now()
        if checked is None:
            self._full = False
            return False
        self._waiting.append(checked)
        return True

    def _next(self) -> Received[M] | None:
        while self._waiting or self._pump():
            received = self._decode(self._waiting.popleft())
            if received is not None:
                return received
        return None

    def _decode(self, checked: Checked) -> Received[M] | None:
        stamp, sequence, frame, stream, arrived = checked
        try:
            content = frame[stream.payload :] if len(frame) < _SMALL else memoryview(frame)[stream.payload :]
            message = stream.decode(content)
        except (ValueError, msgspec.DecodeError, RecursionError):  # ValueError: also of text and of arrays
            self._undecodable += 1
            return None
        return Received(message, stamp, sequence, stream.name, arrived)
