"""Commands of ROS that a cable has held back: refused, for what comes late nobody wants any more.

How long one was on its way is by the wall clocks of both computers, which are chrony's or PTP's to keep: where the
sender's is behind by more, all of its commands are refused.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.qos import QoSProfile

from valor.ros.node import Untouched
from valor.ros.taking import uncalled

LATE = 1.0  # a command from another computer that was sent longer ago is refused [s]
TOLD = 1.0  # between two words of one topic [s]
SOON = 0.5  # a goal's request has both servers of its service within [s]
REQUESTS = 100  # remembered
_LOOK = 1e-3  # between two [s]
_log = logging.getLogger("ros")

Info = Mapping[str, int | None]
"""What rclpy tells of a message."""


def timely(topic: str, callback: Callable[[Any, Info], object], *, others: bool) -> Callable[[Any, Info], object]:
    """A callback that passes on what was sent at most ``LATE`` ago, and logs what was not.

    Without ``others``, computers that may command, it is the callback itself. Messages without stamps are passed on.
    """
    if not others:
        return callback
    told = -math.inf

    def pass_on(message: Any, info: Info) -> None:
        nonlocal told
        why = _late(info.get("source_timestamp"), info.get("received_timestamp"))
        if not why:
            callback(message, info)
        elif time.monotonic() - told >= TOLD:
            told = time.monotonic()
            _log.warning("%s: refused: %s", topic, why)

    return pass_on


class GoalAges:
    """How long an action's goals were on their way, which rclpy does not tell.

    A second server of the service by which goals are sent hears the same requests, with their stamps. It answers none.
    """

    def __init__(self, node: Node, action_type: Any, name: str) -> None:
        """Listen; to be made before the action's server, so that no client knows that one alone."""
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
        """Why a goal is not to be obeyed, in words for its client; empty: it is timely. Waits for what it must know."""
        key, until = bytes(handle.goal_id.uuid), time.monotonic() + SOON
        while True:
            self._hear()
            if (why := self._late.pop(key, None)) is not None:
                return why
            if time.monotonic() > until:
                return "when it was sent is not known; send it again"
            time.sleep(_LOOK)

    def destroy(self) -> None:
        """Listen no more."""
        self._node.destroy_service(self._service)

    def _hear(self) -> None:
        while True:
            with self._service.handle:
                request, header = self._service.handle.service_take_request(self._service.srv_type.Request)
            if header is None:
                return
            # Of requests Fast DDS' layer says when they were sent, and says it again for when they were received.
            self._late[bytes(request.goal_id.uuid)] = _late(header.source_timestamp, time.time_ns())
            if len(self._late) > REQUESTS:
                del self._late[next(iter(self._late))]


def _late(sent: int | None, received: int | None) -> str:
    """Why what was sent and received then [ns] is refused; empty: it is not, or there are no stamps."""
    late = 1e-9 * (received - sent) if sent and received else 0.0
    if late <= LATE:
        return ""
    return f"came {late:.1f} s after it was sent, by both computers' wall clocks; expected at most {LATE:g} s"
