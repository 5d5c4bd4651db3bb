"""The one ROS node of the VRC, and the thread that runs its callbacks."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions

from valor.common.errors import ConfigurationError
from valor.common.floods import TopicFloods

PERIOD = 4e-3  # that of the update loop [s]
CALLBACKS = 10  # in one
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Of topics that say how things are: who joins late is told the last message, too."""

_log = logging.getLogger("ros")


class _CommandNode(Node):  # type: ignore[misc]  # rclpy is untyped
    """A node whose subscriptions are commands, and counted."""

    def __init__(self, name: str) -> None:
        self.floods = TopicFloods(
            lambda topic: (publisher.node_name for publisher in self.get_publishers_info_by_topic(topic))
        )
        super().__init__(name, enable_rosout=False)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[[Any], None], qos_profile: Any, **options: Any
    ) -> Any:
        return super().create_subscription(
            msg_type, topic, self.floods.counted(topic, callback), qos_profile, **options
        )


class RosThread(threading.Thread):
    """Owns the node; its callbacks (goals, cancellations, commands, timers) run here and nowhere else.

    Attributes:
        node: the ROS node.
        floods: of the topics that it subscribes to.
        failures: callbacks that raised: logged, counted, and the thread goes on.
    """

    def __init__(self, name: str, arguments: list[str]) -> None:
        """Join the ROS domain of the environment.

        Args:
            name: of the node.
            arguments: of the command line, for ROS (``--ros-args -p update_rate:=125``).

        Raises:
            ConfigurationError: the arguments are not ROS arguments.
        """
        super().__init__(name="ros", daemon=True)
        try:
            # Signals are the service's own: it ends its loop first and ROS last.
            rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        except Exception as error:
            raise ConfigurationError(f"ROS arguments {arguments}: {' '.join(str(error).split())}") from None
        self.node = _CommandNode(name)
        self.floods = self.node.floods
        self.failures = 0
        self._closing = False
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def run(self) -> None:
        """The thread: so many callbacks a period at most, for it shares the interpreter with the update loop.

        What comes quicker waits in ROS' own queues, which keep the newest.
        """
        done, until = 0, 0.0
        while not self._closing:
            now = time.monotonic()
            if now >= until:
                done, until = 0, now + PERIOD
            elif done >= CALLBACKS:
                time.sleep(until - now)
                continue
            done += 1
            try:
                self._executor.spin_once()
            except (ExternalShutdownException, ShutdownException):
                return
            except Exception:
                # A message that cannot be taken (text that is not UTF-8, say) must not end the thread.
                self.failures += 1
                _log.exception("a ROS callback failed")

    def close(self) -> None:
        """End the thread, then the node, then ROS."""
        self._closing = True
        self._executor.wake()
        if self.is_alive():
            self.join()
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()
