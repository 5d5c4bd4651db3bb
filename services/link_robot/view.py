"""The newest picture of the robot's view, of any camera's compressed topic. Nobody asks for one: nobody listens."""

from __future__ import annotations

import time
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage

from valor.link.bulk.things import Held
from valor.link.bulk.wire import LONGEST_NAME
from valor.link.classes import Bulk
from valor.link.end import End
from valor.ros.node import Untouched
from valor.ros.taking import take, uncalled

STREAM = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class View:
    """Listens while the operator's end is there; the middleware keeps one picture, taken when it is asked for."""

    def __init__(self, node: Node, end: End, topic: str) -> None:
        """``topic``: empty: there is no camera."""
        self._node, self._end, self._topic = node, end, topic
        self._group = Untouched()
        self._subscription: Any = None
        self._held: Held | None = None

    def listen(self, wanted: bool) -> None:
        """Or not any more."""
        if wanted and self._subscription is None and self._topic:
            self._subscription = self._node.create_subscription(
                CompressedImage, self._topic, uncalled, STREAM, callback_group=self._group
            )
        elif not wanted and self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription, self._held = None, None

    def newest(self) -> Held | None:
        """The newest that has come; None: none has."""
        while self._subscription is not None and (taken := take(self._subscription)) is not None:
            message, stamps = taken
            now = time.monotonic()
            age = max(0.0, time.time() - 1e-9 * stamps["source_timestamp"])  # since it was published
            clock = max(1, round(1e3 * (self._end.clock(now) - age)))
            frame = message.header.frame_id[:LONGEST_NAME]
            self._held = Held(Bulk.PICTURE, frame, bytes(message.data), clock, message.format[:64])
        return self._held
