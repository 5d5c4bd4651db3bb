"""ROS topics as Foxglove channels: serialized messages with their type definitions, subscribed while a client watches.

Meshes that ``/robot_description`` names by ``file:`` are served as assets; no other file is.
"""

import logging
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree

import foxglove
from foxglove.websocket import ChannelView, Client, ServerListener
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from valor.ros.definitions import UnknownTypeError, definition, message_type
from valor.ros.taking import polled, take
from valor.ros.topics import asks_less, shown, suiting

DESCRIPTION, DESCRIPTION_TYPE = "robot_description", "std_msgs/msg/String"


class Assets:
    """Files that may be fetched: set by the loop from the description, read by the server's threads."""

    _named: frozenset[str] = frozenset()

    def learn(self, data: bytes) -> None:
        """Add the mesh names of a serialized description; invalid XML has none."""
        try:
            root = ElementTree.fromstring(deserialize_message(data, String).data)
        except ElementTree.ParseError:
            return
        self._named |= {mesh.attrib.get("filename", "") for mesh in root.iter("mesh")}

    def read(self, uri: str) -> bytes | None:
        """Return a mesh file; None if no description names it, or it is not readable."""
        parts = urlsplit(uri)
        if uri not in self._named or parts.scheme != "file":
            return None
        try:
            return Path(unquote(parts.path)).read_bytes()
        except OSError:
            return None


class Watchers(ServerListener):
    """Clients by watched channel, from the server's threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._clients: dict[int, set[int]] = {}  # by channel
        self._new: set[int] = set()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Store a client of a channel."""
        with self._lock:
            self._clients.setdefault(channel.id, set()).add(client.id)
            self._new.add(channel.id)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        """Remove a client of a channel, also when it disconnects."""
        with self._lock:
            self._clients.get(channel.id, set()).discard(client.id)

    def look(self) -> tuple[frozenset[int], frozenset[int]]:
        """Return the watched channels, and those with a new client since the last call."""
        with self._lock:
            watched = frozenset(channel for channel, clients in self._clients.items() if clients)
            new, self._new = watched & self._new, set()
        return watched, new

    @property
    def clients(self) -> int:
        """Number of clients that watch a channel."""
        with self._lock:
            return len(set[int]().union(*self._clients.values()))


DEPTH = 500  # Messages queued, and read at most per topic and poll

_log = logging.getLogger("foxglove_bridge")


class _Topic:
    """Topic, subscribed while a client watches."""

    def __init__(self, name: str, type_name: str, context: foxglove.Context) -> None:
        schema = foxglove.Schema(name=type_name, encoding="ros2msg", data=definition(type_name).encode())
        self.name, self.type = name, message_type(type_name)
        self.describes = (name.rpartition("/")[2], type_name) == (DESCRIPTION, DESCRIPTION_TYPE)
        self.channel = foxglove.Channel(name, schema=schema, message_encoding="cdr", context=context)
        self.subscription: Any = None
        self.qos: QoSProfile | None = None

    def subscribe(self, node: Any, qos: QoSProfile) -> None:
        self.unsubscribe(node)
        self.subscription = polled(node, self.type, self.name, qos, raw=True)
        self.qos = qos

    def unsubscribe(self, node: Any) -> None:
        if self.subscription is not None:
            node.destroy_subscription(self.subscription)
        self.subscription = self.qos = None

    @property
    def latched(self) -> bool:
        return self.qos is not None and self.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL

    def take(self) -> Iterator[tuple[bytes, int]]:
        """Yield serialized messages with the time of reception [ns]."""
        for _ in range(DEPTH):
            if (taken := take(self.subscription)) is None:
                return
            yield taken[0], taken[1]["received_timestamp"]


class RosChannels:
    """Channels of all public topics of the graph. A topic that disappears keeps its channel."""

    def __init__(self, node: Any, context: foxglove.Context, meshes: Assets) -> None:
        self._node, self._context, self._meshes = node, context, meshes
        self._namespace = node.get_namespace().strip("/")
        self._topics: dict[str, _Topic] = {}
        self._refused: set[str] = set()

    def discover(self) -> None:
        """Offer new topics, and subscribe again where publishers now offer less than requested."""
        for name, types in self._node.get_topic_names_and_types():
            if name not in self._topics and name not in self._refused and shown(name, self._namespace):
                self._offer(name, types)
        for topic in self._topics.values():
            if topic.qos is not None and asks_less(qos := self._suiting(topic), topic.qos):
                topic.subscribe(self._node, qos)

    def follow(self, watched: frozenset[int], new: frozenset[int]) -> None:
        """Subscribe to watched topics only; subscribe again for a new client of a latched topic."""
        for topic in self._topics.values():
            channel = topic.channel.id()
            if channel not in watched:
                topic.unsubscribe(self._node)
            elif topic.subscription is None or (channel in new and topic.latched):
                topic.subscribe(self._node, self._suiting(topic))

    def forward(self) -> int:
        """Forward received messages; return their number."""
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
