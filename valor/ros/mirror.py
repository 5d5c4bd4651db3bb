"""Bifrost messages as their mirror types of ``valor_msgs``, and back."""

import array
from typing import Any, TypeVar

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile

from bifrost import Message, Received
from valor.common.arrays import sequence
from valor.ros.node import WALL

M = TypeVar("M", bound=Message)


def to_ros(received: Received[Any], mirror: Any) -> None:
    """Fill the ROS message with a Bifrost message and its sequence, stamped with the wall clock."""
    mirror.header.stamp = WALL.now().to_msg()
    mirror.bifrost_sequence = received.sequence
    for name in received.message.__struct_fields__:
        value = getattr(received.message, name)
        setattr(mirror, name, sequence(value) if isinstance(value, np.ndarray) else value)


def from_ros(message_type: type[M], mirror: Any) -> M:
    values = {name: getattr(mirror, name) for name in message_type.__struct_fields__}
    return message_type(
        **{name: np.array(value) if isinstance(value, array.array) else value for name, value in values.items()}
    )


class MirrorPublisher:
    """Publishes Bifrost messages of one type as their mirror type, in one reused message."""

    def __init__(self, node: Node, mirror: type[Any], topic: str, qos: QoSProfile | int) -> None:
        self._publisher = node.create_publisher(mirror, topic, qos)
        self._message = mirror()

    def publish(self, received: Received[Any]) -> None:
        to_ros(received, self._message)
        self._publisher.publish(self._message)
