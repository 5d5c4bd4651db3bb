"""Action server whose goals are finished from outside.

rclpy executes a goal in a callback that lasts as long as the goal. With a single-threaded executor that callback
blocks everything else or, as a coroutine, is resumed without pause and uses a full core. Here an accepted goal is only
stored; its owner finishes it, and the executor thread then sends the result.
"""

import logging
from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from valor.ros.lateness import GoalAges

RESULT_TIMEOUT = 60  # of the results of ended goals [s of robot time]
EXPIRY_PERIOD = 30.0  # [s of robot time]

_log = logging.getLogger("ros")


class _SparseClockNode:
    """Node whose clock stands still between two calls of ``get_clock``, each of which sets it to robot time.

    rcl's timer of expired results wakes the executor at every change of its clock once its period has passed, also
    while it is canceled. Robot time changes at the control rate; this clock only for a goal and for expiry.
    """

    def __init__(self, node: Node) -> None:
        self._node, self._clock = node, Clock(clock_type=ClockType.ROS_TIME)
        self._clock.handle.set_ros_time_override_is_enabled(True)

    def get_clock(self) -> Clock:
        self._clock.set_ros_time_override(self._node.get_clock().now())
        return self._clock

    def __getattr__(self, name: str) -> Any:
        return getattr(self._node, name)


class DeferredActionServer(ActionServer):  # type: ignore[misc]  # rclpy is untyped
    """Accepts every goal, so that a rejected one has a result with the reason; see ``finish``."""

    def __init__(
        self,
        node: Node,
        action_type: type,
        name: str,
        on_goal: Callable[[ServerGoalHandle], None],
        on_cancel: Callable[[ServerGoalHandle], CancelResponse],
        *,
        on_late: Callable[[ServerGoalHandle, str], None] | None = None,
    ) -> None:
        """Create the server. All callbacks run in the executor's thread.

        Args:
            node: ROS node.
            action_type: generated.
            name: of the action.
            on_goal: called with each goal, which is executing. An exception ends the goal.
            on_cancel: decides on a cancellation.
            on_late: finishes a goal that arrives late, for a reason; None: lateness is not checked.
        """
        self._name = name
        self._on_goal, self._on_late = on_goal, on_late
        self._ages = None if on_late is None else GoalAges(node, action_type, name)
        super().__init__(
            _SparseClockNode(node),
            action_type,
            name,
            lambda _: None,
            handle_accepted_callback=self._accepted,
            cancel_callback=on_cancel,
            result_timeout=RESULT_TIMEOUT,
        )
        self._expiry = node.create_timer(EXPIRY_PERIOD, self._node.get_clock)

    def _accepted(self, handle: ServerGoalHandle) -> None:
        handle.execute()
        try:
            if self._on_late and self._ages and (reason := self._ages.late(handle)):
                _log.warning("%s: rejected: %s", self._name, reason)
                self._on_late(handle, reason)
            else:
                self._on_goal(handle)
        except Exception:
            self.finish(handle, "abort", self.action_type.Result())  # the client does not wait forever
            raise

    def destroy(self) -> None:
        super().destroy()
        self._node.destroy_timer(self._expiry)
        if self._ages is not None:
            self._ages.destroy()

    def notify_execute(self, goal_handle: ServerGoalHandle, execute_callback: Callable[..., Any] | None) -> None:
        """Called by ``ServerGoalHandle.execute``; without a callback there is nothing to run yet."""
        if execute_callback is not None:
            super().notify_execute(goal_handle, execute_callback)

    def notify_goal_done(self) -> None:
        """Called when a goal has ended; its result expires ``RESULT_TIMEOUT`` later."""
        self._node.get_clock()
        super().notify_goal_done()

    def finish(self, handle: ServerGoalHandle, state: str, result: object) -> None:
        """End a goal with its result; from any thread.

        Args:
            handle: of the goal.
            state: ``succeed``, ``abort`` or ``canceled``, as in rclpy; ``canceled`` aborts a goal whose cancellation
                was not requested. During a cancellation only ``canceled`` and ``succeed`` are possible.
            result: of the action's type.
        """

        def end(handle: ServerGoalHandle) -> object:
            getattr(handle, "abort" if state == "canceled" and not handle.is_cancel_requested else state)()
            return result

        self.notify_execute(handle, end)
