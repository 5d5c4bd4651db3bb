"""ROS 2 Jazzy, rclpy on Fast DDS over UDP, which is quicker here than its shared memory; best effort, depth 1000."""

from __future__ import annotations

import array
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Int64, UInt8MultiArray

from benchmarks.interprocess.payloads import SIZES
from benchmarks.interprocess.transports import STAMP, Place

_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


class _Node:
    def __init__(self, place: Place, payload: str, end: str) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=place.number % 100 + 1)
        name = f"{end}_{SIZES[payload]}"
        self.node = rclpy.create_node(name, context=self._context, enable_rosout=False, start_parameter_services=False)
        self.executor = SingleThreadedExecutor(context=self._context)
        self.executor.add_node(self.node)
        self.topic = f"benchmark_{place.folder.name}_{SIZES[payload]}"
        self.type: Any = Int64 if payload == "8 B" else UInt8MultiArray

    def close(self) -> None:
        """Leave."""
        self.executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()


class Sender(_Node):
    """A node with one publisher."""

    def __init__(self, place: Place, payload: str) -> None:
        super().__init__(place, payload, "sender")
        self._publisher = self.node.create_publisher(self.type, self.topic, _QOS)
        self._message = self.type()
        self._data = array.array("B", bytes(SIZES[payload]))

    def send(self) -> None:
        """See the package."""
        if self.type is Int64:
            self._message.data = time.monotonic_ns()
        else:
            STAMP.pack_into(self._data, 0, time.monotonic_ns())
            self._message.data = self._data
        self._publisher.publish(self._message)


class Receiver(_Node):
    """A node with one subscription."""

    def __init__(self, place: Place, payload: str) -> None:
        super().__init__(place, payload, "receiver")
        self._take: Callable[[int], None] = lambda stamp: None
        self.node.create_subscription(self.type, self.topic, self._received, _QOS)

    def _received(self, message: Any) -> None:
        self._take(message.data if self.type is Int64 else STAMP.unpack_from(message.data)[0])

    def run(self, take: Callable[[int], None], stop: Callable[[], bool]) -> None:
        """See the package."""
        self._take = take
        while not stop():
            self.executor.spin_once(timeout_sec=0.1)
