"""ROS topics as channels: their bytes as they are, with the definition of their type, while somebody looks."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

import foxglove
from rclpy.qos import DurabilityPolicy, QoSProfile

from valor.foxglove_bridge import assets
from valor.foxglove_bridge.assets import Assets
from valor.ros.definitions import UnknownTypeError, definition, message_type
from valor.ros.node import Untouched
from valor.ros.taking import take, uncalled
from valor.ros.topics import asks_less, shown, suiting

DEPTH = 500  # messages that may wait for the next look, and the most that are taken of a topic at one

_log = logging.getLogger("foxglove_bridge")


class _Topic:
    """One topic; without a subscription while nobody looks."""

    def __init__(self, name: str, type_name: str, context: foxglove.Context) -> None:
        schema = foxglove.Schema(name=type_name, encoding="ros2msg", data=definition(type_name).encode())
        self.name, self.type = name, message_type(type_name)
        self.describes = (name.rpartition("/")[2], type_name) == (assets.TOPIC, assets.TYPE)
        self.channel = foxglove.Channel(name, schema=schema, message_encoding="cdr", context=context)
        self.subscription: Any = None
        self.qos: QoSProfile | None = None

    def subscribe(self, node: Any, qos: QoSProfile) -> None:
        """Hear it from now on, what it is latched with included."""
        self.unsubscribe(node)
        self.subscription = node.create_subscription(
            self.type, self.name, uncalled, qos, callback_group=Untouched(), raw=True
        )
        self.qos = qos

    def unsubscribe(self, node: Any) -> None:
        """Hear it no more."""
        if self.subscription is not None:
            node.destroy_subscription(self.subscription)
        self.subscription = self.qos = None

    @property
    def latched(self) -> bool:
        """Whether who comes late is told what was said before."""
        return self.qos is not None and self.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL

    def take(self) -> Iterator[tuple[bytes, int]]:
        """What has come, and when the middleware received it [ns]."""
        for _ in range(DEPTH):
            if (taken := take(self.subscription)) is None:
                return
            yield taken[0], taken[1]["received_timestamp"]


class RosChannels:
    """All topics of the graph that are for others. A topic that was once there keeps its channel."""

    def __init__(self, node: Any, context: foxglove.Context, meshes: Assets) -> None:
        self._node, self._context, self._meshes = node, context, meshes
        self._namespace = node.get_namespace().strip("/")
        self._topics: dict[str, _Topic] = {}
        self._refused: set[str] = set()

    def discover(self) -> None:
        """Offer topics that are new, and hear those anew whose publishers now offer less than was asked for."""
        for name, types in self._node.get_topic_names_and_types():
            if name not in self._topics and name not in self._refused and shown(name, self._namespace):
                self._offer(name, types)
        for topic in self._topics.values():
            if topic.qos is not None and asks_less(qos := self._suiting(topic), topic.qos):
                topic.subscribe(self._node, qos)

    def follow(self, watched: frozenset[int], new: frozenset[int]) -> None:
        """Subscribe to what somebody looks at, and leave the rest; who is new to a latched topic is told it."""
        for topic in self._topics.values():
            channel = topic.channel.id()
            if channel not in watched:
                topic.unsubscribe(self._node)
            elif topic.subscription is None or (channel in new and topic.latched):
                topic.subscribe(self._node, self._suiting(topic))

    def forward(self) -> int:
        """Hand on what has come; how many messages."""
        number = 0
        for topic in self._topics.values():
            if topic.subscription is not None:
                for data, received in topic.take():
                    if topic.describes:
                        self._meshes.learn(data)
                    topic.channel.log(data, log_time=received)
                    number += 1
        return number

    def _offer(self, name: str, types: list[str]) -> None:
        if not self._node.count_publishers(name):
            return
        try:
            if len(types) > 1:
                raise UnknownTypeError(f"it has more than one type: {', '.join(sorted(types))}")
            self._topics[name] = _Topic(name, types[0], self._context)
        except UnknownTypeError as error:
            self._refused.add(name)
            _log.warning("%s: not shown: %s", name, error)

    def _suiting(self, topic: _Topic) -> QoSProfile:
        publishers = self._node.get_publishers_info_by_topic(topic.name)
        return suiting([each.qos_profile for each in publishers], DEPTH)
