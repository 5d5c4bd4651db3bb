"""Subscribers: each has its own socket and queue."""

import time
from collections import deque
from typing import Any, Generic

import msgspec
import zmq

from bifrost.directory import Entry
from bifrost.discovery import Discovery
from bifrost.encoding import Codec, codec
from bifrost.intake import Checked, Intake
from bifrost.limits import LOOKS, Limit
from bifrost.messages import M
from bifrost.waiting import Waitable

_SMALL = 4096  # messages below this size are copied, which is faster than a view [B]


class Received(msgspec.Struct, Generic[M], gc=False, eq=False):
    """A message and its envelope.

    Attributes:
        message: decoded; its arrays are read-only.
        stamp: time of publication by this computer's monotonic clock [ns]; another computer's is converted
            (``bifrost.clocks``).
        sequence: the publisher's count, from 1.
        origin: name of the node that published it.
        arrived: time of receipt, before decoding, by this computer's monotonic clock [ns].
    """

    message: M
    stamp: int
    sequence: int
    origin: str
    arrived: int = 0


class Subscriber(Intake, Waitable, Generic[M]):
    """Receives the messages of one topic. Made by ``Node.subscriber``."""

    def __init__(
        self,
        discovery: Discovery,
        topic: str,
        message_type: type[M] | None,
        queue: int | None,
        *,
        limit: Limit | None = None,
    ) -> None:
        own: Codec[Any] | None = None if message_type is None else codec(message_type)
        super().__init__(discovery, topic, own, queue, limit)
        self._waiting: deque[Checked] = deque()  # checked but not delivered
        self._woken = False
        self._closed = False
        self._full = False  # the last call reached its limit of messages
        types, hashes, schemas = ((), (), ()) if own is None else ((own.name,), (own.hash.hex(),), (own.schema,))
        self._key = discovery.announce(Entry("subscriber", topic, types, hashes), schemas, self)

    def latest(self) -> Received[M] | None:
        """The latest message not yet returned, or None; discards older ones. Never blocks."""
        while True:
            for _ in range(LOOKS):
                if not self._pump():
                    break
            else:
                self._full = True
            if not self._waiting:
                return None
            latest = max(self._waiting)
            self._waiting.clear()
            received = self._decode(latest)
            if received is not None:
                return received

    def receive(self, timeout: float | None = None) -> Received[M] | None:
        """The next message; without a queue the latest.

        Args:
            timeout: time to wait [s]; None: no limit. Zero or less: do not wait.

        Returns:
            None after the timeout, or after ``wake``.
        """
        if timeout is not None and timeout <= 0.0:
            # With one publisher, ZeroMQ has already discarded all but the latest.
            return self._next() if self._keep_all or not (self._waiting or self.several) else self.latest()
        deadline = 0.0 if timeout is None else time.monotonic() + timeout
        milliseconds = -1 if timeout is None else int(timeout * 1000.0) + 1
        while True:
            if self._waiting:
                received = self._next() if self._keep_all else self.latest()
            else:
                # One call into ZeroMQ per message: it waits and returns.
                checked = self._within(milliseconds)
                received = None
                if checked is not None:
                    if self._keep_all or not self.several:
                        received = self._decode(checked)
                    else:  # each of several publishers has its own latest message
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
        """Make a waiting ``receive`` return; otherwise possibly the next one. From any thread."""
        self._woken = True
        self._discovery.wake(self.topic)

    def drain(self, most: int | None = None, within: float | None = None) -> list[Received[M]]:
        """All waiting messages, oldest first; without a queue at most one. Never blocks.

        Args:
            most: maximum number of messages; the others remain, see ``left``. Several publishers take turns.
            within: time after which no further message is started [s].
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
        """True if messages may remain after the last call; a ``Poller`` reports them again."""
        return self._full or self._more

    def fileno(self) -> int:
        """Descriptor for an event loop, edge-triggered: ``drain`` or ``latest`` until nothing is left, then wait."""
        return int(self.socket.getsockopt(zmq.FD))

    @property
    def pollable(self) -> zmq.Socket[bytes]:
        """Socket for ``bifrost.wait`` and ZeroMQ's pollers."""
        return self.socket

    def ready(self) -> bool:
        """Return whether a message waits. Never blocks."""
        return bool(self._waiting) or self._pump()

    def patience(self) -> float | None:
        """Zero if a message waits outside the socket, where polling does not detect it."""
        return 0.0 if self._waiting else None

    def close(self) -> None:
        """Unsubscribe and close the socket."""
        if not self._closed:
            self._closed = True
            self._discovery.withdraw(self._key)
            self._discovery.unwatch(self._watch)
            self.socket.close()

    def _pump(self) -> bool:
        """Move one message into ``_waiting``; False when there is none."""
        checked = self._now()
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
        except (ValueError, RecursionError):  # ValueError: also of text and arrays
            self.rejected += 1
            return None
        return Received(message, stamp, sequence, stream.name, arrived)
