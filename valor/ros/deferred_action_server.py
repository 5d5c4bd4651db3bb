"""An action server whose goals are finished from outside.

rclpy's executes a goal in a callback that lasts as long as the goal. With a single-threaded executor that callback
either blocks everything else or, as a coroutine, is resumed without pause and burns a core. Here an accepted goal is
only kept; the control loop finishes it when its time has come, and the executor thread then sends the result.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node

from valor.ros.lateness import GoalAges

_log = logging.getLogger("ros")


class DeferredActionServer(ActionServer):  # type: ignore[misc]  # rclpy is untyped
    """Accepts every goal, so that a refused one too can be told why; see ``finish``."""

    def __init__(
        self,
        node: Node,
        action_type: type,
        name: str,
        on_goal: Callable[[ServerGoalHandle], None],
        on_cancel: Callable[[ServerGoalHandle], CancelResponse],
        *,
        late: Callable[[str], object] | None = None,
    ) -> None:
        """Offer an action.

        Args:
            node: the ROS node.
            action_type: generated.
            name: absolute.
            on_goal: is given each goal, already executing; in the executor's thread. What it raises ends the goal.
            on_cancel: says whether a goal may be canceled; likewise.
            late: makes the result of one that was held back on its way, and is refused, of the reason; None: it is
                obeyed as all others.
        """
        self._name = name
        self._on_goal = on_goal
        self._late = late
        self._ages = None if late is None else GoalAges(node, action_type, name)
        super().__init__(
            node,
            action_type,
            name,
            lambda _: None,
            handle_accepted_callback=self._accepted,
            cancel_callback=on_cancel,
            result_timeout=60,
        )

    def _accepted(self, handle: ServerGoalHandle) -> None:
        handle.execute()
        if self._late is not None and self._ages is not None and (why := self._ages.late(handle)):
            _log.warning("%s: refused: %s", self._name, why)
            self.finish(handle, "abort", self._late(why))
            return
        try:
            self._on_goal(handle)
        except Exception:
            self.finish(handle, "abort", self.action_type.Result())  # whoever waits is not left waiting
            raise

    def destroy(self) -> None:
        """Offer it no more."""
        super().destroy()
        if self._ages is not None:
            self._ages.destroy()

    def notify_execute(self, goal_handle: ServerGoalHandle, execute_callback: Callable[..., Any] | None) -> None:
        """Called by ``ServerGoalHandle.execute``: without a callback there is nothing to run yet."""
        if execute_callback is not None:
            super().notify_execute(goal_handle, execute_callback)

    def finish(self, handle: ServerGoalHandle, state: str, result: object) -> None:
        """End a goal with its result; from any thread.

        Args:
            handle: of the goal.
            state: ``succeed``, ``abort`` or ``canceled``, as rclpy names them. A goal that ends while its
                cancellation is asked for can only be canceled or succeed.
            result: of the action's type.
        """

        def end(handle: ServerGoalHandle) -> object:
            if state == "canceled" and not handle.is_cancel_requested:
                handle.abort()
            else:
                getattr(handle, state)()
            return result

        self.notify_execute(handle, end)
