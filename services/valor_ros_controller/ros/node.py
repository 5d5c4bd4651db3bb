"""The one ROS node of the VRC, and the thread that runs its callbacks."""

from __future__ import annotations

import logging
import threading
import time
from functools import partial
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, ShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile

from valor.common.floods import TopicFloods
from valor.ros.lateness import timely
from valor.ros.node import ProcessNode, RosSide
from valor.service import Context

PERIOD = 4e-3  # that of the update loop [s]
CALLBACKS = 10  # in one
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Of topics that say how things are: who joins late is told the last message, too."""

_log = logging.getLogger("ros")


class _CommandNode(ProcessNode):
    """A node whose subscriptions are commands, and counted; those of other computers must be timely."""

    def __init__(self, name: str, context: rclpy.Context, *, others: bool) -> None:
        """Join; ``others``: other computers may command."""
        self.floods = TopicFloods(
            lambda topic: (publisher.node_name for publisher in self.get_publishers_info_by_topic(topic))
        )
        super().__init__(name, context, knows_time=True, others=others)

    def create_subscription(self, msg_type: Any, topic: str, callback: Any, qos_profile: Any, **options: Any) -> Any:
        """Of a command, counted."""
        name = self.resolve_topic_name(topic)
        counted = self.floods.counted(name, callback)
        obeyed = timely(name, counted, others=self.others)
        return super().create_subscription(msg_type, topic, obeyed, qos_profile, **options)


class RosThread(threading.Thread):
    """Owns the node; its callbacks (goals, cancellations, commands, timers) run here and nowhere else.

    Attributes:
        node: the ROS node.
        life: of the node.
        floods: of the topics that it subscribes to.
        failures: callbacks that raised: logged, counted, and the thread goes on.
    """

    def __init__(self, context: Context) -> None:
        """Join the instance's ROS domain, as the command line says (``--ros-args -p update_rate:=125``).

        Args:
            context: of the process.

        Raises:
            ConfigurationError: the arguments are not ROS arguments.
        """
        super().__init__(name="ros", daemon=True)
        environment = context.instance.environment()
        node = partial(_CommandNode, others=bool(context.settings.peers))
        self._side = RosSide(context.name, context.settings, environment, context.arguments, node=node)
        self.node, self.life, self._executor = self._side.node, self._side.life, self._side.executor
        self.floods = self.node.floods
        self.failures = 0
        self._closing = False

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
        self._side.close()
