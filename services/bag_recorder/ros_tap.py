"""What the recorder takes from ROS 2: every topic of the graph, as the bytes that came.

Nothing spins. The middleware receives in threads of its own and stamps what it receives; the recorder takes the bytes
from each subscription's queue at its own pace, which costs some microseconds a message where an executor's wake-up
costs over a hundred.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile

from valor.bag_recorder.bag import SHARE, RecordedTopic, Sink
from valor.bag_recorder.clock import WallClock
from valor.bags.selection import Selection
from valor.ros.definitions import UnknownTypeError, definition, message_type, type_hash
from valor.ros.node import Untouched
from valor.ros.taking import uncalled
from valor.ros.topics import asks_less, qos_text, shown, suiting

DEPTH = 2000  # messages a topic that may wait for the next look
ROUNDS = 8  # of discovery, in which every known topic is looked over once

_log = logging.getLogger("bag_recorder")


class _Tap:
    """One topic's subscription.

    Attributes:
        received, unwritten: messages so far, and those of them that no bag could take.
        lost: messages that the one publisher sent and that never came; not known where there are several.
    """

    untouched = Untouched()

    def __init__(self, node: Any, topic: RecordedTopic, message_type: type, qos: QoSProfile) -> None:
        self.topic = topic
        self.message_type = message_type
        self.qos = qos
        self.received = self.unwritten = self.lost = 0
        self.publishers = 0
        self.seen = 0  # publishers in the graph when the tap was last looked over, the recorder's own included
        self._last = 0
        self.subscription = node.create_subscription(
            message_type, topic.name, uncalled, qos, callback_group=self.untouched, raw=True
        )

    def follow(self, sequence: int) -> None:
        """Count what is missing before a message of the publisher's count ``sequence``."""
        if self.publishers == 1 and 0 < self._last < sequence:
            self.lost += sequence - self._last - 1
        self._last = sequence  # one that begins anew comes from a new publisher

    def resubscribed(self, before: _Tap) -> None:
        """Go on with the counts of the subscription that this one replaces."""
        self.received, self.unwritten, self.lost = before.received, before.unwritten, before.lost


class RosTap:
    """Discovers topics, subscribes with a QoS that suits all their publishers, and moves what has come into the bag."""

    def __init__(
        self,
        node: Any,
        clock: WallClock,
        selection: Selection,
        alive: Callable[[], None] = lambda: None,
        namespace: str = "",
    ) -> None:
        """Nothing is subscribed to yet.

        Args:
            node: of the graph; closed by its owner.
            clock: that tells the times of messages.
            selection: of the topics.
            alive: called now and then while much is found or taken.
            namespace: of the robot: what stands in another is not recorded; empty: all is.
        """
        self._clock, self._selection, self._alive, self._namespace = clock, selection, alive, namespace
        self._node = node
        self._taps: dict[str, _Tap] = {}
        self._refused: set[str] = set()
        self._round = 0

    @property
    def counts(self) -> dict[str, tuple[int, int]]:
        """Received and dropped since start, by topic."""
        return {name: (tap.received, tap.lost + tap.unwritten) for name, tap in self._taps.items()}

    def discover(self) -> None:
        """Subscribe to topics that are new, and anew to those whose publishers now offer less than was asked for.

        Asking who publishes a topic takes ten times as long as asking how many: what is known is asked the former when
        the number has changed, and now and then in turn.
        """
        self._round = (self._round + 1) % ROUNDS
        for i, (name, types) in enumerate(self._node.get_topic_names_and_types()):
            if name in self._refused or not shown(name, self._namespace) or name not in self._selection:
                continue
            self._alive()
            count = self._node.count_publishers(name)
            known = self._taps.get(name)
            if known is not None and count == known.seen and i % ROUNDS != self._round:
                continue
            publishers = [
                each
                for each in self._node.get_publishers_info_by_topic(name)
                if each.node_name != self._node.get_name()
            ]
            if not publishers:
                continue
            qos = suiting([publisher.qos_profile for publisher in publishers], DEPTH)
            tap = self._taps.get(name)
            if tap is None:
                self._subscribe(name, types, qos)
            elif asks_less(qos, tap.qos):
                self._node.destroy_subscription(tap.subscription)
                self._taps[name] = _Tap(self._node, tap.topic, tap.message_type, qos)
                self._taps[name].resubscribed(tap)
            if name in self._taps:
                self._taps[name].publishers = len(publishers)
                self._taps[name].seen = count

    def drain(self, sink: Sink | None) -> None:
        """Hand on what waits; without a sink it is let go.

        ``log_time`` is when the middleware received a message, ``publish_time`` when it was sent, both on the wall
        clock as it went at start.

        Raises:
            OSError: the bag cannot be written.
        """
        drift = self._clock.drift
        for tap in self._taps.values():
            self._alive()
            handle, message_type = tap.subscription.handle, tap.message_type
            with handle:
                while (taken := handle.take_message(message_type, True)) is not None:
                    data, info = taken
                    sequence = info["publication_sequence_number"] or 0
                    tap.received += 1
                    if tap.received % SHARE == 0:
                        self._alive()
                    tap.follow(sequence)
                    if sink is None:
                        tap.unwritten += 1
                        continue
                    received, sent = info["received_timestamp"] - drift, info["source_timestamp"] - drift
                    sink.write(tap.topic, received, sent, sequence, data)

    def _subscribe(self, name: str, types: list[str], qos: QoSProfile) -> None:
        try:
            if len(types) > 1:
                raise UnknownTypeError(f"it has more than one type: {', '.join(sorted(types))}")
            latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
            topic = RecordedTopic(name, types[0], definition(types[0]), qos_text(qos), latched, type_hash(types[0]))
            self._taps[name] = _Tap(self._node, topic, message_type(types[0]), qos)
        except UnknownTypeError as error:
            self._refused.add(name)
            _log.warning("%s: not recorded: %s", name, error)
