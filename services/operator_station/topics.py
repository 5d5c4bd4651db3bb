"""Other topics' numbers as signals: of those that somebody wants to see, and while the page is there."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from valor.operator_station.signals import numbers_of
from valor.ros.definitions import UnknownTypeError, message_type
from valor.ros.node import Untouched
from valor.ros.taking import uncalled, waiting
from valor.ros.topics import shown, suiting

LOOKED = 3.0  # between two looks at which topics there are [s]
MOST = 12  # topics that are listened to: of more, the oldest is let go


class Topics:
    """Listens to what it is told to. From one thread."""

    def __init__(self, node: Node, namespace: str) -> None:
        """``node``: no executor may take from the subscriptions; ``namespace``: of the robot, empty: none."""
        self._node, self._namespace = node, namespace
        self._subscriptions: dict[str, Any] = {}
        self._values: dict[str, dict[str, float]] = {}
        self._types: dict[str, str] = {}
        self._looked = float("-inf")

    def values(self) -> Mapping[str, float]:
        """The newest number of each field, by topic and field."""
        for topic, subscription in self._subscriptions.items():
            newest = None
            for message in waiting(subscription):
                newest = message
            if newest is not None:
                self._values[topic] = numbers_of(topic, newest)
        return {name: value for known in self._values.values() for name, value in known.items()}

    def offered(self) -> Sequence[str]:
        """Topics of this robot's that are published now and have a type that is known here."""
        if time.monotonic() - self._looked > LOOKED:
            self._looked = time.monotonic()
            self._types = {
                name: kinds[0]
                for name, kinds in self._node.get_topic_names_and_types()
                if len(kinds) == 1 and shown(name, self._namespace) and self._node.count_publishers(name)
            }
        return sorted(self._types)

    def listen(self, name: str) -> None:
        """To one of those offered; nothing happens if it is none, or heard already."""
        if name in self._subscriptions or name not in self._types:
            return
        try:
            kind = message_type(self._types[name])
        except UnknownTypeError:
            return
        while len(self._subscriptions) >= MOST:
            oldest = next(iter(self._subscriptions))
            self._node.destroy_subscription(self._subscriptions.pop(oldest))
            self._values.pop(oldest, None)
        offered = [info.qos_profile for info in self._node.get_publishers_info_by_topic(name)]
        qos: QoSProfile = suiting(offered, depth=1)
        self._subscriptions[name] = self._node.create_subscription(
            kind, name, uncalled, qos, callback_group=Untouched()
        )
