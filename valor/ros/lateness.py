"""Rejection of ROS commands from other hosts received more than 1 s (wall clock) after sending.

The wall clocks of both hosts must be synchronised, by chrony or PTP. If the sender's clock is slow by more than 1 s,
all of its commands are rejected.
"""

import logging
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.qos import QoSProfile

from valor.ros.taking import Untouched, uncalled

LATE = 1.0  # age from which on a command from another host is rejected [s]
LOG_PERIOD = 1.0  # of one topic [s]
REQUEST_TIMEOUT = 0.5  # until both servers of a goal's service have received its request [s]
REQUESTS = 100  # stored
_POLL_PERIOD = 1e-3  # [s]
_log = logging.getLogger("ros")

Info = Mapping[str, int | None]
"""Message info of rclpy."""


def reject_late(topic: str, callback: Callable[[Any, Info], object], *, others: bool) -> Callable[[Any, Info], object]:
    """Callback that forwards messages sent at most ``LATE`` ago, and logs others.

    Without ``others``, other hosts that may command, it is the callback itself. Messages without stamps are forwarded.
    """
    if not others:
        return callback
    logged_at = -math.inf

    def forward(message: Any, info: Info) -> None:
        nonlocal logged_at
        reason = _late(info.get("source_timestamp"), info.get("received_timestamp"))
        if not reason:
            callback(message, info)
        elif time.monotonic() - logged_at >= LOG_PERIOD:
            logged_at = time.monotonic()
            _log.warning("%s: rejected: %s", topic, reason)

    return forward


class GoalAges:
    """Ages of an action's goals, which rclpy does not provide.

    A second server of the goal service receives the same requests with their stamps, and answers none. It must be
    created before the action's server, so that clients discover both.
    """

    def __init__(self, node: Node, action_type: Any, name: str) -> None:
        self._node = node
        self._late: dict[bytes, str] = {}  # by the goal's id
        self._service = node.create_service(
            action_type.Impl.SendGoalService,
            f"{name}/_action/send_goal",
            uncalled,
            qos_profile=QoSProfile(depth=REQUESTS),
            callback_group=Untouched(),
        )

    def late(self, handle: ServerGoalHandle) -> str:
        """Reason to reject a goal; empty if it is in time. Waits for the stamps."""
        key, until = bytes(handle.goal_id.uuid), time.monotonic() + REQUEST_TIMEOUT
        while True:
            self._take()
            if (reason := self._late.pop(key, None)) is not None:
                return reason
            if time.monotonic() > until:
                return "time of sending unknown; send it again"
            time.sleep(_POLL_PERIOD)

    def destroy(self) -> None:
        self._node.destroy_service(self._service)

    def _take(self) -> None:
        while True:
            with self._service.handle:
                request, header = self._service.handle.service_take_request(self._service.srv_type.Request)
            if header is None:
                return
            # For requests, rmw_fastrtps reports the time of sending also as the time of reception.
            self._late[bytes(request.goal_id.uuid)] = _late(header.source_timestamp, time.time_ns())
            if len(self._late) > REQUESTS:
                del self._late[next(iter(self._late))]


def _late(sent: int | None, received: int | None) -> str:
    """Reason to reject a message sent and received at these times [ns]; empty if in time, or without stamps."""
    late = 1e-9 * (received - sent) if sent and received else 0.0
    if late <= LATE:
        return ""
    return f"received {late:.1f} s after it was sent, by both hosts' wall clocks; expected at most {LATE:g} s"
