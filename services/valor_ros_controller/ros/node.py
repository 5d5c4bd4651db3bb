"""ROS node of the VRC, and the thread of its callbacks."""

import logging
import threading
import time
from functools import partial
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, ShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile

from valor.common.input_checks import TopicFloods
from valor.ros.lateness import reject_late
from valor.ros.node import ProcessNode, RosSide
from valor.service import Context

PERIOD = 4e-3  # of the update loop [s]
CALLBACKS = 10  # per period
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""QoS of states: late subscribers receive the last message."""

_log = logging.getLogger("ros")


class CommandNode(ProcessNode):
    """Node whose subscriptions count commands, and reject late ones of other hosts."""

    def __init__(self, name: str, context: rclpy.Context, *, others: bool) -> None:
        """``others``: other hosts may command."""
        self.floods = TopicFloods(
            lambda topic: (publisher.node_name for publisher in self.get_publishers_info_by_topic(topic))
        )
        super().__init__(name, context, sets_time=True, others=others)

    def create_subscription(self, msg_type: Any, topic: str, callback: Any, qos_profile: Any, **options: Any) -> Any:
        return super().create_subscription(msg_type, topic, self.checked(topic, callback), qos_profile, **options)

    def checked(self, topic: str, callback: Any) -> Any:
        """Callback that counts the messages of a topic and rejects late ones."""
        name = self.resolve_topic_name(topic)
        return reject_late(name, self.floods.counted(name, callback), others=self.others)


class RosThread(threading.Thread):
    """Runs all callbacks of the node: goals, cancellations, commands, timers."""

    def __init__(self, context: Context) -> None:
        """Join the instance's ROS domain with the command line's ROS arguments.

        Raises ConfigurationError: invalid ROS arguments.
        """
        super().__init__(name="ros", daemon=True)
        environment = context.instance.environment()
        node = partial(CommandNode, others=bool(context.settings.peers))
        self._side = RosSide(context.name, context.settings, environment, context.arguments, node=node)
        self.node, self.life, self._executor = self._side.node, self._side.life, self._side.executor
        self.floods = self.node.floods  # of subscribed topics
        self.failures = 0  # number of callbacks that raised; they are logged
        self._closing = False

    def run(self) -> None:
        """Run callbacks, at most ``CALLBACKS`` per period: the thread shares the interpreter with the update loop.

        Further messages wait in ROS' queues.
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
                # A message that cannot be converted (text that is not UTF-8, say) must not end the thread.
                self.failures += 1
                _log.exception("a ROS callback failed")

    def close(self) -> None:
        """End the thread, then the node, then ROS."""
        self._closing = True
        self._executor.wake()
        if self.is_alive():
            self.join()
        self._side.close()
