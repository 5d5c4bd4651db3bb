"""ROS side of the recorder: every topic of the graph, as serialized bytes.

No executor spins. The middleware receives and stamps messages in its own threads; the recorder polls each
subscription's queue, which costs some microseconds per message. An executor's wake-up costs over a hundred.
"""

import logging
from collections.abc import Callable
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile

from valor.bag_recorder.bag import SHARE, RecordedTopic, Sink
from valor.bag_recorder.clock import StampConverter
from valor.bags.selection import Selection
from valor.ros.definitions import UnknownTypeError, definition, message_type, type_hash
from valor.ros.taking import polled
from valor.ros.topics import asks_less, qos_text, shown, suiting

DEPTH = 2000  # queue length per topic [messages]
ROUNDS = 8  # of discovery, over which every known topic is checked once

_log = logging.getLogger("bag_recorder")


class _Tap:
    """One topic's subscription."""

    def __init__(self, topic: RecordedTopic) -> None:
        self.topic = topic
        self.message_type = message_type(topic.type)
        self.received = self.unwritten = 0  # messages, and those of them received while no bag could be written
        self.lost = 0  # messages of the only publisher that were not received; not counted with several publishers
        self.publishers = self.seen = 0  # without the recorder's; and with it, at the last check
        self.qos: QoSProfile | None = None
        self.subscription: Any = None
        self._last = 0

    def subscribe(self, node: Any, qos: QoSProfile) -> None:
        """Subscribe, unless there is a subscription that requests no more than ``qos``."""
        if self.qos is not None:
            if not asks_less(qos, self.qos):
                return
            node.destroy_subscription(self.subscription)
        self.qos = qos
        self.subscription = polled(node, self.message_type, self.topic.name, qos, raw=True)

    def follow(self, sequence: int) -> None:
        """Count the messages missing before the publisher's message number ``sequence``."""
        if self.publishers == 1 and 0 < self._last < sequence:
            self.lost += sequence - self._last - 1
        self._last = sequence  # a number that restarts comes from a new publisher


class RosTap:
    """Discovers topics, subscribes with a QoS compatible with all publishers, and passes messages to a sink."""

    def __init__(
        self,
        node: Any,
        clock: StampConverter,
        selection: Selection,
        alive: Callable[[], None] = lambda: None,
        namespace: str = "",
    ) -> None:
        """Create the tap without subscriptions.

        ``alive``: watchdog, called repeatedly during long work; ``namespace``: the only one recorded, if not empty.
        """
        self._clock, self._selection, self._alive, self._namespace = clock, selection, alive, namespace
        self._node = node
        self._taps: dict[str, _Tap] = {}
        self._rejected: set[str] = set()
        self._round = 0

    @property
    def counts(self) -> dict[str, tuple[int, int]]:
        return {name: (tap.received, tap.lost + tap.unwritten) for name, tap in self._taps.items()}

    def discover(self) -> None:
        """Subscribe to new topics, and again to topics whose publishers now offer less than the subscription requests.

        Querying the publishers of a topic takes ten times as long as counting them: of known topics they are queried
        after their number changed, and once in ``ROUNDS`` calls.
        """
        self._round = (self._round + 1) % ROUNDS
        for i, (name, types) in enumerate(self._node.get_topic_names_and_types()):
            if name in self._rejected or not shown(name, self._namespace) or name not in self._selection:
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
            tap = known or self._tap(name, types, qos)
            if tap is not None:
                tap.subscribe(self._node, qos)
                tap.publishers, tap.seen = len(publishers), count

    def drain(self, sink: Sink | None) -> None:
        """Pass the waiting messages to a sink; without a sink, count them as dropped.

        ``log_time`` is the reception by the middleware, ``publish_time`` the sending, both without the clock's drift.
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

    def _tap(self, name: str, types: list[str], qos: QoSProfile) -> _Tap | None:
        """A new tap of a topic; None if the topic cannot be recorded."""
        try:
            if len(types) > 1:
                raise UnknownTypeError(f"it has more than one type: {', '.join(sorted(types))}")
            latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
            topic = RecordedTopic(name, types[0], definition(types[0]), qos_text(qos), latched, type_hash(types[0]))
            tap = self._taps[name] = _Tap(topic)
        except UnknownTypeError as error:
            self._rejected.add(name)
            _log.warning("%s: not recorded: %s", name, error)
            return None
        return tap
