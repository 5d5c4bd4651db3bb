"""Subscription to ``TwistStamped`` on a topic to which the VRC subscribes with ``Twist``.

A participant of Fast DDS has one type per topic. The other type has a second participant, from the first publisher on.
"""

import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from geometry_msgs.msg import TwistStamped
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.type_support import check_for_type_support

from valor.ros.node import STEADY, ProcessNode

TYPE = "geometry_msgs/msg/TwistStamped"
DISCOVERY_PERIOD = 1.0  # between two searches for publishers [s]
PERIOD = 0.004  # between two messages; faster publishers' latest counts [s]
ENDING = 0.1  # time in which the thread ends after ROS [s]


class StampedVelocity:
    """Subscribes once there is a publisher; callbacks run in a separate thread, which ends with the node's context."""

    def __init__(self, ros: ProcessNode, topic: str, callback: Callable[..., Any]) -> None:
        """``topic``: resolved; ``callback``: of messages with rclpy's message info."""
        self._ros, self._topic, self._callback = ros, topic, callback
        check_for_type_support(TwistStamped)  # loaded now: it takes longer than a control period
        self._timer = ros.create_timer(DISCOVERY_PERIOD, self._look, clock=STEADY)

    def _look(self) -> None:
        if any(publisher.topic_type == TYPE for publisher in self._ros.get_publishers_info_by_topic(self._topic)):
            self._ros.destroy_timer(self._timer)
            threading.Thread(target=self._run, name="stamped_velocity").start()

    def _run(self) -> None:
        first, context = self._ros.context, rclpy.Context()
        rclpy.init(
            args=[], context=context, domain_id=first.get_domain_id(), signal_handler_options=SignalHandlerOptions.NO
        )
        node = rclpy.create_node(
            f"{self._ros.get_name()}_stamped_velocity", context=context, namespace=self._ros.get_namespace(),
            use_global_arguments=False, enable_rosout=False, start_parameter_services=False,
        )  # fmt: skip
        node.create_subscription(TwistStamped, self._topic, self._callback, 1)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        while first.ok():
            try:
                executor.spin_once(timeout_sec=ENDING)
            except ExternalShutdownException:
                break
            time.sleep(PERIOD)
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
