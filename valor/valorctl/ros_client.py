"""A short-lived ROS 2 node that sends action goals into an instance.

Importing rclpy takes a good part of a second: only verbs that need it import this module.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from valor.common.errors import ValorError
from valor.common.instance import Instance

_SERVER_TIMEOUT = 10.0  # until an action server is discovered [s]
_RESPONSE_TIMEOUT = 20.0  # until it accepts or refuses a goal, on a computer however busy [s]
_CANCEL_TIMEOUT = 2.0  # until it acknowledges that a goal is cancelled [s]
_DIAGNOSTICS_AGE = 0.5  # at most, of what they tell when they come [s]
_DIAGNOSTICS_TIMEOUT = 3.0  # they come once a second [s]


class GoalRefusedError(ValorError):
    """The action server refused the goal without a result."""


class RosClient:
    """A node in the instance's ROS domain and namespace. Used from one thread."""

    def __init__(self, instance: Instance, check: Callable[[], None] = lambda: None, domain: int | None = None) -> None:
        """Join the instance.

        Args:
            instance: must be up.
            check: called while waiting; may raise to give up.
            domain: of ROS; None: the instance's.

        Raises:
            ValorError: the instance obeys nobody on ROS 2.
        """
        if refusal := instance.settings().ros_refusal:
            raise ValorError(refusal)
        os.environ.update(instance.environment())  # read by the middleware's C++ when it starts
        self._check = check
        self._context = rclpy.Context()
        rclpy.init(
            context=self._context,
            domain_id=instance.settings().ros_domain_id if domain is None else domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._node = rclpy.create_node(
            f"valorctl_{os.getpid()}",
            context=self._context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            cli_args=[*instance.settings().ros_arguments],
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def subscribe(self, message_type: Any, topic: str, hear: Callable[[Any], None], qos: Any) -> None:
        """Hear a topic as long as the node lives, while something is waited for."""
        self._node.create_subscription(message_type, topic, hear, qos)

    def publisher(self, message_type: Any, topic: str, listeners: int, timeout: float = _SERVER_TIMEOUT) -> Any:
        """A publisher of a topic, once that many listen.

        Raises:
            ValorError: not within ``timeout`` [s].
        """
        made = self._node.create_publisher(message_type, topic, 10)
        self._spin(lambda: made.get_subscription_count() >= listeners, timeout, f"{topic}: not {listeners} listeners")
        return made

    def set_parameter(self, node: str, name: str, value: float) -> None:
        """Set a parameter of another node.

        Raises:
            ValorError: it does not answer, or refuses; says why.
        """
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        client = self._node.create_client(SetParameters, f"{node}/set_parameters")
        try:
            self._spin(client.service_is_ready, _SERVER_TIMEOUT, f"{node}: no service set_parameters")
            parameter = Parameter(name, value=value).to_parameter_msg()
            setting = client.call_async(SetParameters.Request(parameters=[parameter]))
            self._spin(setting.done, _RESPONSE_TIMEOUT, f"{node} does not set {name}")
            result = setting.result().results[0]
            if not result.successful:
                raise ValorError(f"{node}: {name} = {value:g} refused: {result.reason}")
        finally:
            self._node.destroy_client(client)

    def wait(self, done: Callable[[], bool], timeout: float, what: str) -> None:
        """Wait until ``done()``.

        Raises:
            ValorError: not within ``timeout`` [s]; begins with ``what``.
        """
        self._spin(done, timeout, what)

    def rest(self) -> None:
        """Hear for a moment."""
        self._check()
        self._executor.spin_once(timeout_sec=0.02)

    def call_action(
        self, action_type: Any, name: str, goal: Any, timeout: float, hear: Callable[[Any], None] | None = None
    ) -> Any:
        """Send a goal and wait for its result. Whatever ends the wait early cancels the goal.

        Args:
            action_type: the action's class.
            name: of the action.
            goal: its goal.
            timeout: for the result [s].
            hear: given each feedback.

        Returns:
            The result message.

        Raises:
            ValorError: no such server, the goal refused, or no result in time.
        """
        client = ActionClient(self._node, action_type, name)
        try:
            self._spin(client.server_is_ready, _SERVER_TIMEOUT, f"nobody serves the action {name}")
            accepting = client.send_goal_async(goal, (lambda each: hear(each.feedback)) if hear else None)
            self._spin(accepting.done, _RESPONSE_TIMEOUT, f"{name} does not answer a goal")
            handle = accepting.result()
            if handle is None or not handle.accepted:
                raise GoalRefusedError(f"{name} refused the goal")
            finishing = handle.get_result_async()
            try:
                self._spin(finishing.done, timeout, f"{name}: no result")
            except BaseException:
                self._cancel(handle)
                raise
            return finishing.result().result
        finally:
            client.destroy()

    def diagnosis(self, key: str) -> str:
        """What the VRC's diagnostics say now under a key; empty when they do not come."""
        from diagnostic_msgs.msg import DiagnosticArray

        told: list[str] = []
        began = time.monotonic()

        def hear(message: DiagnosticArray) -> None:
            # What is sent first may be older than what we want to know.
            if time.monotonic() - began > _DIAGNOSTICS_AGE:
                told.extend(pair.value for status in message.status for pair in status.values if pair.key == key)

        subscription = self._node.create_subscription(DiagnosticArray, "diagnostics", hear, 1)
        try:
            self._spin(lambda: bool(told), _DIAGNOSTICS_TIMEOUT, "")
        except ValorError:
            return ""
        finally:
            self._node.destroy_subscription(subscription)
        return told[0]

    def _cancel(self, handle: Any) -> None:
        cancelling = handle.cancel_goal_async()
        check, self._check = self._check, lambda: None
        with contextlib.suppress(ValorError):
            self._spin(cancelling.done, _CANCEL_TIMEOUT, "")
        self._check = check

    def _spin(self, done: Callable[[], bool], timeout: float, what: str) -> None:
        deadline = time.monotonic() + timeout
        while not done():
            self._check()
            if time.monotonic() > deadline:
                raise ValorError(f"{what} within {timeout:g} s")
            self._executor.spin_once(timeout_sec=0.02)
