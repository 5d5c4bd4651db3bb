"""The robot's actions as servers in the operator's ROS domain: goals are sent through the link, results returned."""

import contextlib
import logging
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from rclpy.action import CancelResponse
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus
from vigir_humanoid_control_msgs.action import ChangeControlMode
from vigir_humanoid_control_msgs.msg import ControlModeStatus

from valor.link.classes import MessageClass
from valor.link.endpoint import LinkEndpoint
from valor.link.errors import SealError
from valor.ros.deferred_action_server import DeferredActionServer
from valor.ros.link_messages import ACTIONS, LinkMessageType, MessageCodec, pack_message
from valor.ros.node import ProcessNode

CAPACITY = 8  # commands in the history
PENDING, ACCEPTED = "pending", "accepted"
_STATUS = {"succeed": "succeeded", "canceled": "canceled", "abort": "aborted"}
_STATES = {GoalStatus.STATUS_SUCCEEDED: "succeed", GoalStatus.STATUS_CANCELED: "canceled"}
_log = logging.getLogger("link_operator")


def _rejected_mode(_: str) -> Any:
    status = ControlModeStatus(status=ControlModeStatus.MODE_REJECTED | ControlModeStatus.ERR_CONTROLLER_NOT_READY)
    return ChangeControlMode.Result(result=status)


def _rejected_trajectory(reason: str) -> Any:
    code = FollowJointTrajectory.Result.INVALID_GOAL
    return FollowJointTrajectory.Result(error_code=code, error_string=reason)


def _rejected_plan(_: str) -> Any:
    result = ExecuteStepPlan.Result()
    result.status.status = FootstepExecutionStatus.ERR_CONTROLLER_NOT_READY
    return result


REJECTED: Mapping[Any, Callable[[str], Any]] = {
    ChangeControlMode: _rejected_mode,
    FollowJointTrajectory: _rejected_trajectory,
    ExecuteStepPlan: _rejected_plan,
}
"""Result of a rejected goal by action type; if it has no field for the reason, only ``/rosout`` has it."""


class CommandHistory:
    """Name, link id and status of the last commands."""

    def __init__(self) -> None:
        self._entries: OrderedDict[int, tuple[str, str, float]] = OrderedDict()  # name, status, since [s]
        self._without_id = 0

    def sent(self, number: int, name: str) -> None:
        """Add a command with its link id."""
        self._put(number, name, PENDING)

    def unsent(self, name: str, reason: str) -> None:
        """Add a command that was not sent."""
        self._without_id -= 1
        self._put(self._without_id, name, f"not sent: {reason}")

    def update(self, number: int, status: str) -> None:
        """Set the status of a command."""
        if number in self._entries:
            self._entries[number] = (self._entries[number][0], status, time.monotonic())

    def end_session(self, reason: str) -> None:
        """End all open commands; link ids start again."""
        entries, self._entries = list(self._entries.values()), OrderedDict()
        for name, status, since in entries:
            self._without_id -= 1
            self._entries[self._without_id] = (name, reason if status in (PENDING, ACCEPTED) else status, since)

    def name(self, number: int) -> str:
        """Name of a command; empty if it is not stored."""
        return self._entries[number][0] if number in self._entries else ""

    def lines(self, now: float) -> dict[str, str]:
        """Values for ``/link/status``: ``last_command`` and, for earlier ones, ``command_2``, …; ``now`` [s]."""
        keys = ("last_command", *(f"command_{number}" for number in range(2, CAPACITY + 1)))
        texts = [
            f"{name.removesuffix('/follow_joint_trajectory').rsplit('/', 1)[-1]}: {status}, {now - since:.0f} s ago"
            for name, status, since in reversed(self._entries.values())
        ]
        return dict(zip(keys, texts or [""], strict=False))

    def _put(self, number: int, name: str, status: str) -> None:
        self._entries[number] = (name, status, time.monotonic())
        while len(self._entries) > CAPACITY:
            self._entries.popitem(last=False)


class Goals:
    """Active goals. For the thread that spins the node."""

    def __init__(
        self,
        node: ProcessNode,
        end: LinkEndpoint,
        codec: MessageCodec,
        history: CommandHistory,
        before: Callable[[], str],
    ) -> None:
        """``before``: called before a goal is sent; returns the reason not to send it, empty if there is none."""
        self._end, self._codec, self._history, self._before = end, codec, history, before
        self._active: dict[int, tuple[int, Any]] = {}  # by link id: index in ACTIONS, handle
        self._expired: set[int] = set()  # not acknowledged; canceled if the robot accepts them after all
        self._servers = [
            DeferredActionServer(
                node, each.type, each.name, partial(self._send, index), self._cancel,
                on_late=partial(self._unsent, index) if node.others else None,
            )
            for index, each in enumerate(ACTIONS)
        ]  # fmt: skip

    def _unsent(self, index: int, handle: Any, reason: str) -> None:
        action = ACTIONS[index]
        self._history.unsent(action.name, reason)
        self._servers[index].finish(handle, "abort", REJECTED[action.type](reason))

    def _send(self, index: int, handle: Any) -> None:
        if reason := self._before():
            self._unsent(index, handle, reason)
            return
        content = pack_message(LinkMessageType.GOAL, index, self._codec.pack(handle.request))
        try:
            number = self._end.send(MessageClass.COMMAND, content, time.monotonic())
        except SealError as error:
            self._unsent(index, handle, str(error))
            return
        self._active[number] = (index, handle)
        self._history.sent(number, ACTIONS[index].name)

    def _cancel(self, handle: Any) -> CancelResponse:
        for number, (_, each) in self._active.items():
            if each.goal_id == handle.goal_id:
                with contextlib.suppress(SealError):
                    self._send_cancel(number)
                    return CancelResponse.ACCEPT
        return CancelResponse.REJECT

    def _send_cancel(self, number: int) -> None:
        self._end.send(MessageClass.COMMAND, pack_message(LinkMessageType.CANCEL, number), time.monotonic())

    def accepted(self, number: int) -> None:
        """Process the acceptance of a goal or another command; cancel a goal that has already expired here."""
        self._history.update(number, ACCEPTED if number in self._active else "done")
        if number in self._expired:
            self._expired.discard(number)
            self._send_cancel(number)

    def reject(self, number: int, reason: str) -> None:
        """Process the rejection of a goal or another command."""
        _log.warning("command %d rejected: %s", number, reason)
        self._history.update(number, f"rejected: {reason}")
        if (found := self._active.pop(number, None)) is not None:
            index, handle = found
            self._servers[index].finish(handle, "canceled", REJECTED[ACTIONS[index].type](reason))

    def feedback(self, number: int, feedback: Any) -> Any:
        """Publish feedback of a goal; returns the goal's id, None if it is not active."""
        if (found := self._active.get(number)) is None:
            return None
        found[1].publish_feedback(feedback)
        return found[1].goal_id

    def expired(self, number: int) -> None:
        """Store a command that was not acknowledged before its deadline."""
        if number in self._active:
            self._expired.add(number)

    def end(self, number: int, content: bytes) -> None:
        """Process the robot's result. Raises SealError: malformed."""
        if (found := self._active.pop(number, None)) is None:
            return
        index, handle = found
        result = self._codec.unpack(content[1:], ACTIONS[index].type.Result)
        state = _STATES.get(content[0] if content else 0, "abort")
        self._history.update(number, _STATUS[state])
        self._servers[index].finish(handle, state, result)

    def end_session(self, reason: str) -> None:
        """End all active goals."""
        for number in list(self._active):
            self.reject(number, reason)
        self._expired.clear()

    def close(self) -> None:
        """Destroy the servers."""
        for server in self._servers:
            server.destroy()
