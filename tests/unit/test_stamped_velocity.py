"""Velocities of both of ROS' types are received on one topic, at any rate."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.signals import SignalHandlerOptions

from harness.instance import RunningInstance
from harness.waiting import PATIENCE, wait_until
from valor.common.instance import Settings
from valor.ros.node import RosSide
from valor.valor_ros_controller.ros.node import CommandNode
from valor.valor_ros_controller.ros.stamped_velocity import StampedVelocity


@contextmanager
def client(domain: int, kind: type) -> Iterator[Any]:
    """A publisher of another process' kind, with a participant of its own."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(f"client_{kind.__name__.lower()}", context=context)
    yield node.create_publisher(kind, "/cmd_vel", 1)
    node.destroy_node()
    context.try_shutdown()


def test_both_types_are_received_at_1_khz_and_the_thread_ends_with_ros(instance: RunningInstance) -> None:
    settings = Settings(robot=Path("escher"), ros_domain_id=instance.settings.ros_domain_id)
    side = RosSide("vrc", settings, {}, (), node=partial(CommandNode, others=False))
    node, received = side.node, list[Any]()
    assert isinstance(node, CommandNode)
    node.create_subscription(Twist, "cmd_vel", received.append, 1)
    StampedVelocity(node, "/cmd_vel", node.checked("cmd_vel", received.append))
    domain = settings.ros_domain_id
    with client(domain, Twist) as plain, client(domain, TwistStamped) as stamped:

        def took(what: set[type]) -> bool:
            plain.publish(Twist())
            stamped.publish(TwistStamped())
            side.executor.spin_once(timeout_sec=0.0)
            return {type(message) for message in received} == what

        wait_until(lambda: took({Twist, TwistStamped}), PATIENCE, "velocities of both types", period=0.001)
        assert "stamped_velocity" in {thread.name for thread in threading.enumerate()}
    side.close()
    wait_until(lambda: "stamped_velocity" not in {t.name for t in threading.enumerate()}, PATIENCE, "the thread's end")
