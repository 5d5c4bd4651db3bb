"""Bifrost messages on ROS as they are: their twins of ``valor_msgs``."""

from __future__ import annotations

import array
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile

from bifrost import Received
from valor.ros.node import WALL


class TwinPublisher:
    """Publishes messages of one Bifrost type on one ROS topic; the message is made once and filled anew."""

    def __init__(self, node: Node, twin: type[Any], topic: str, qos: QoSProfile | int) -> None:
        """Make publisher and message.

        Args:
            node: the ROS node.
            twin: type of the twin.
            topic: name of the ROS topic.
            qos: quality of service, or depth.
        """
        self._publisher = node.create_publisher(twin, topic, qos)
        self._message = twin()

    def publish(self, received: Received[Any]) -> None:
        """Publish a message, with its origin and sequence."""
        message, twin = received.message, self._message
        twin.header.stamp = WALL.now().to_msg()
        twin.header.frame_id = received.origin
        twin.bifrost_sequence = received.sequence
        for name in message.__struct_fields__:
            value = getattr(message, name)
            if isinstance(value, np.ndarray):
                value = array.array("B" if value.dtype == np.uint8 else "d", value.tobytes())
            setattr(twin, name, value)
        self._publisher.publish(twin)
