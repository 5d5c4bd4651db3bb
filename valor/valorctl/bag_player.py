"""Playing a bag: its messages, as the bytes they are, on ROS topics of their own names and at their own pace."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from valor.bags.selection import Selection
from valor.bags.stored import StoredBag, StoredTopic, in_order
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.ros.definitions import UnknownTypeError, message_type
from valor.valorctl import ros_domain

DEPTH = 100
_DISCOVERY = 1.0  # in which those who listen already are found [s]


@dataclass(frozen=True)
class Played:
    """What became of it.

    Attributes:
        messages: published.
        skipped: topics that cannot be published, and why.
        damage: of the bag.
    """

    messages: int
    skipped: dict[str, str]
    damage: list[str]


def play(
    file: Path,
    instance: Instance,
    *,
    domain: int | None,
    rate: float,
    topics: Sequence[str],
    check: Callable[[], None],
    tell: Callable[[float, int], None],
) -> Played:
    """Play a bag into a ROS domain in which no robot system runs.

    Args:
        file: a bag.
        instance: any of the home whose systems are left alone even where their supervisord was killed.
        domain: None: ``ROS_DOMAIN_ID``, else 0.
        rate: of the bag's own pace.
        topics: shell patterns; none: all.
        check: raises when the user wants to stop.
        tell: is told the bag's time [s] and how many messages have been played.

    Raises:
        ValorError: no bag, a rate that is none, or a domain that is taken.
    """
    if not (math.isfinite(rate) and rate > 0.0):
        raise ValorError(f"--rate {rate:g}: expected a number above 0")
    domain = int(os.environ.get("ROS_DOMAIN_ID") or 0) if domain is None else domain
    if ros_domain.is_reserved(domain) or domain in ros_domain.taken(instance.folder.parent):
        raise ValorError(
            f"ROS domain {domain} is a running system's, which would obey the bag; choose another: --domain"
        )
    bag = StoredBag(file)
    with _Publishers(domain) as publishers:
        first: int | None = None
        began, played = 0.0, 0
        wanted = Selection(tuple(topics))
        for topic, stamp, data, _ in in_order(each for each in bag.messages() if each.topic.name in wanted):
            publisher = publishers.of(topic)
            if publisher is None:
                continue
            if first is None:
                first, began = stamp, time.monotonic()
            passed = (stamp - first) * 1e-9
            while (wait := began + passed / rate - time.monotonic()) > 0.0:
                check()
                time.sleep(min(wait, 0.1))
            publisher.publish(data)
            played += 1
            if played % 100 == 1:
                check()
                tell(passed, played)
        publishers.settle()
        return Played(played, publishers.skipped, bag.condition.damage)


class _Publishers:
    """A node in a domain, and its publishers by topic."""

    def __init__(self, domain: int) -> None:
        import rclpy
        from rclpy.context import Context

        self.skipped: dict[str, str] = {}
        self._publishers: dict[str, Any] = {}
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node("bag_player", context=self._context, enable_rosout=False)
        time.sleep(_DISCOVERY)  # who is in the domain already

    def __enter__(self) -> _Publishers:
        return self

    def __exit__(self, *_: object) -> None:
        self._node.destroy_node()
        self._context.try_shutdown()

    def of(self, topic: StoredTopic) -> Any:
        """Its publisher; None: it cannot be published."""
        from rclpy.qos import DurabilityPolicy, QoSProfile

        if topic.name in self.skipped:
            return None
        publisher = self._publishers.get(topic.name)
        if publisher is None:
            try:
                kind = message_type(topic.type)
            except (ValueError, UnknownTypeError):
                self.skipped[topic.name] = f"type {topic.type or 'unknown'} is not installed here"
                return None
            durability = DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE
            qos = QoSProfile(depth=DEPTH, durability=durability)
            publisher = self._publishers[topic.name] = self._node.create_publisher(kind, topic.name, qos)
            self._wait_for_listeners(publisher)
        return publisher

    def _wait_for_listeners(self, publisher: Any) -> None:
        """Give those who listen already the time to find it: what is published before is lost to them."""
        until = time.monotonic() + _DISCOVERY
        while time.monotonic() < until:
            if publisher.get_subscription_count() >= self._node.count_subscribers(publisher.topic_name):
                return
            time.sleep(0.01)

    def settle(self) -> None:
        """Wait until all has arrived where somebody listens."""
        from rclpy.duration import Duration

        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=5))
