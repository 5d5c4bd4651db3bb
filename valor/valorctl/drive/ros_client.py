"""Short-lived ROS 2 node of a verb: topics, parameters and action goals.

Importing rclpy takes about 0.5 s: only verbs that need it import this module.
"""

import contextlib
import os
import time
from collections.abc import Callable
from typing import Any, Self

import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from valor.common.errors import ValorError
from valor.common.instance import Instance

_SERVER_TIMEOUT = 10.0  # until an action server is discovered [s]
_RESPONSE_TIMEOUT = 20.0  # until it accepts or rejects a goal, on a busy computer [s]
_CANCEL_TIMEOUT = 2.0  # until it acknowledges a cancellation [s]
_DIAGNOSTICS_AGE = 0.5  # of their content when received, at most [s]
_DIAGNOSTICS_TIMEOUT = 3.0  # published once a second [s]


class GoalRefusedError(ValorError):
    """The action server rejected the goal without a result."""


class RosClient:
    """A node in the instance's ROS domain and namespace, ``node``. Used from one thread."""

    def __init__(self, instance: Instance, check: Callable[[], None] = lambda: None, *, commands: bool = True) -> None:
        """Create the node; ``check`` is called while waiting. Raises ``ValorError``: ROS commands are rejected.

        ``commands``: False if the client only receives.
        """
        if commands and (refusal := instance.settings().ros_refusal):
            raise ValorError(refusal)
        os.environ.update(instance.environment())  # read by the middleware at its start
        self._check = check
        self._context = rclpy.Context()
        rclpy.init(
            context=self._context,
            domain_id=instance.settings().ros_domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = rclpy.create_node(
            f"valorctl_{os.getpid()}",
            context=self._context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            cli_args=[*instance.settings().ros_arguments],
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    def subscribe(self, message_type: Any, topic: str, receive: Callable[[Any], None], qos: Any) -> None:
        """Subscribe; ``receive`` is called while a method of the client waits."""
        self.node.create_subscription(message_type, topic, receive, qos)

    def publisher(self, message_type: Any, topic: str, listeners: int, timeout: float = _SERVER_TIMEOUT) -> Any:
        """Return a publisher once it has that many subscribers; raises ``ValorError`` after ``timeout`` [s]."""
        made = self.node.create_publisher(message_type, topic, 10)
        what = f"{topic}: fewer than {listeners} subscribers"
        self.wait(lambda: made.get_subscription_count() >= listeners, timeout, what)
        return made

    def wait(self, done: Callable[[], bool], timeout: float, what: str) -> None:
        """Process callbacks until ``done()``; raises ``ValorError`` that starts with ``what`` after ``timeout`` [s]."""
        deadline = time.monotonic() + timeout
        while not done():
            if time.monotonic() > deadline:
                raise ValorError(f"{what} within {timeout:g} s")
            self.rest()

    def rest(self) -> None:
        """Process callbacks for at most 20 ms."""
        self._check()
        self._executor.spin_once(timeout_sec=0.02)

    def call_action(
        self, action_type: Any, name: str, goal: Any, timeout: float, feedback: Callable[[Any], None] | None = None
    ) -> Any:
        """Send a goal and return its result message. An exception while waiting cancels the goal.

        Raises ``ValorError``: no server, the goal is rejected, or no result within ``timeout`` [s].
        """
        client = ActionClient(self.node, action_type, name)
        try:
            self.wait(client.server_is_ready, _SERVER_TIMEOUT, f"no server of the action {name}")
            accepting = client.send_goal_async(goal, (lambda each: feedback(each.feedback)) if feedback else None)
            self.wait(accepting.done, _RESPONSE_TIMEOUT, f"{name}: no response to a goal")
            handle = accepting.result()
            if handle is None or not handle.accepted:
                raise GoalRefusedError(f"{name} rejected the goal")
            finishing = handle.get_result_async()
            try:
                self.wait(finishing.done, timeout, f"{name}: no result")
            except BaseException:
                self._cancel(handle)
                raise
            return finishing.result().result
        finally:
            client.destroy()

    def diagnosis(self, key: str) -> str:
        """Value of a key in the VRC's diagnostics; empty if they are not received."""
        from diagnostic_msgs.msg import DiagnosticArray

        found: list[str] = []
        began = time.monotonic()

        def store(message: DiagnosticArray) -> None:
            # The first message may be older than the event of interest.
            if time.monotonic() - began > _DIAGNOSTICS_AGE:
                found.extend(pair.value for status in message.status for pair in status.values if pair.key == key)

        subscription = self.node.create_subscription(DiagnosticArray, "diagnostics", store, 1)
        with contextlib.suppress(ValorError):
            self.wait(lambda: bool(found), _DIAGNOSTICS_TIMEOUT, "")
        self.node.destroy_subscription(subscription)
        return found[0] if found else ""

    def _cancel(self, handle: Any) -> None:
        cancelling = handle.cancel_goal_async()
        check, self._check = self._check, lambda: None
        with contextlib.suppress(ValorError):
            self.wait(cancelling.done, _CANCEL_TIMEOUT, "")
        self._check = check
