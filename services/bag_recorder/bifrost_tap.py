"""What the recorder takes from Bifrost: every topic of the table, as twins under ``/bifrost``."""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable, Sequence
from typing import Any, cast

import bifrost
from valor.bag_recorder.bag import SHARE, RecordedTopic, Sink
from valor.bag_recorder.clock import WallClock
from valor.bag_recorder.twin import TwinEncoder, twin_type
from valor.bags.selection import EVERYTHING, Selection
from valor.common.messages import MotionState
from valor.common.topics import MOTION_STATE, TOPICS, Topic
from valor.ros.definitions import definition, type_hash

PREFIX = "/bifrost/"
QUEUE = 4000  # messages a topic: eight seconds at 500 Hz while the recorder is held up

_log = logging.getLogger("bag_recorder")


class _Tap:
    """One topic."""

    def __init__(self, node: bifrost.Node, topic: Topic[Any]) -> None:
        self.topic = topic
        self.subscriber = topic.subscriber(node, queue=QUEUE, limited=False)
        self.every = topic.record_every
        self.encode = TwinEncoder(topic.type).encode
        name = twin_type(topic.type)
        self.recorded = RecordedTopic(PREFIX + topic.name, name, definition(name), type_hash=type_hash(name))
        self.received = self.unwritten = 0
        self.unfit = 0  # messages that have no twin: an integer beyond 64 signed bits

    @property
    def dropped(self) -> int:
        """Lost on the way here, refused, not convertible, or come while no bag could take them."""
        return self.subscriber.drops + self.subscriber.rejected + self.unfit + self.unwritten


class BifrostTap:
    """Subscribes to every topic that is recorded, and hands on what has come.

    Attributes:
        state: the Motion Manager's newest word, if that is recorded and has come.
    """

    def __init__(
        self,
        node: bifrost.Node,
        clock: WallClock,
        topics: Sequence[Topic[Any]] = TOPICS,
        selection: Selection = EVERYTHING,
        alive: Callable[[], None] = lambda: None,
    ) -> None:
        """Subscribe.

        Args:
            node: to subscribe with.
            clock: that tells the times of messages.
            topics: those that there are.
            selection: of them.
            alive: called now and then while much is taken.
        """
        self._offset, self._alive = clock.offset, alive
        self.state: bifrost.Received[MotionState] | None = None
        self._taps = [
            _Tap(node, topic) for topic in topics if topic.record_every > 0 and PREFIX + topic.name in selection
        ]

    @property
    def heard(self) -> dict[Topic[Any], bifrost.Subscriber[Any]]:
        """The subscriber of each topic that is recorded."""
        return {tap.topic: tap.subscriber for tap in self._taps}

    @property
    def time(self) -> int:
        """Robot time of the Motion Manager's newest word [ns]."""
        return self.state.message.time if self.state is not None else 0

    @property
    def counts(self) -> dict[str, tuple[int, int]]:
        """Received and dropped since start, by topic."""
        return {tap.recorded.name: (tap.received, tap.dropped) for tap in self._taps}

    def drain(self, sink: Sink | None) -> None:
        """Hand on what waits; without a sink it is let go.

        Both times of a message are its publication on the wall clock: when it was drained says nothing of it.

        Raises:
            OSError: the bag cannot be written.
        """
        for tap in self._taps:
            for _ in range(QUEUE // SHARE):  # of each in turn, if one never ends
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
