"""The robot's actions, as servers in the operator's domain: each goal travels, and ends as it does there."""

from __future__ import annotations

import logging
import time
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

from valor.link.classes import Kind
from valor.link.end import End
from valor.link.errors import SealError
from valor.link_operator.fates import Fates
from valor.ros.deferred_action_server import DeferredActionServer
from valor.ros.node import ProcessNode
from valor.ros.relayed import ACTIONS, Action, Deflated, Word, worded

_TOLD = {"succeed": "succeeded", "canceled": "canceled", "abort": "aborted"}
_STATES = {GoalStatus.STATUS_SUCCEEDED: "succeed", GoalStatus.STATUS_CANCELED: "canceled"}
_log = logging.getLogger("link_operator")


def _refused_mode(_: str) -> Any:
    status = ControlModeStatus(status=ControlModeStatus.MODE_REJECTED | ControlModeStatus.ERR_CONTROLLER_NOT_READY)
    return ChangeControlMode.Result(result=status)


def _refused_trajectory(why: str) -> Any:
    code = FollowJointTrajectory.Result.INVALID_GOAL
    return FollowJointTrajectory.Result(error_code=code, error_string=why)


def _refused_plan(_: str) -> Any:
    result = ExecuteStepPlan.Result()
    result.status.status = FootstepExecutionStatus.ERR_CONTROLLER_NOT_READY
    return result


REFUSED: Mapping[Any, Callable[[str], Any]] = {
    ChangeControlMode: _refused_mode,
    FollowJointTrajectory: _refused_trajectory,
    ExecuteStepPlan: _refused_plan,
}
"""The result of a goal that was not done, by action; where it has no place for the reason, ``/rosout`` has it."""


class Goals:
    """Goals under way. From the thread that spins the node."""

    def __init__(self, node: ProcessNode, end: End, deflated: Deflated, fates: Fates) -> None:
        self._end, self._deflated, self._fates = end, deflated, fates
        self._open: dict[int, tuple[int, Any]] = {}  # by the link's id: place in ACTIONS, handle
        self._let_go: set[int] = set()  # that ended here, and might be accepted there yet
        self._servers = [
            DeferredActionServer(
                node, each.type, each.name, partial(self._sent, place), self._cancel,
                late=partial(self._late, each) if node.others else None,
            )
            for place, each in enumerate(ACTIONS)
        ]  # fmt: skip

    def _late(self, action: Action, why: str) -> Any:
        self._fates.unsent(action.name, why)
        return REFUSED[action.type](why)

    def _sent(self, place: int, handle: Any) -> None:
        content = worded(Word.GOAL, place, self._deflated.pack(handle.request))
        try:
            number = self._end.send(Kind.COMMAND, content, time.monotonic())
        except SealError as error:
            self._fates.unsent(ACTIONS[place].name, str(error))
            self._servers[place].finish(handle, "abort", REFUSED[ACTIONS[place].type](str(error)))
            return
        self._open[number] = (place, handle)
        self._fates.sent(number, ACTIONS[place].name)

    def _cancel(self, handle: Any) -> CancelResponse:
        for number, (_, each) in self._open.items():
            if each.goal_id == handle.goal_id:
                try:
                    self._end.send(Kind.COMMAND, worded(Word.CANCEL, number), time.monotonic())
                except SealError:
                    return CancelResponse.REJECT
                return CancelResponse.ACCEPT
        return CancelResponse.REJECT

    def accepted(self, number: int) -> None:
        """The robot has begun a goal, or published a message; a goal that was given up here is canceled there."""
        self._fates.became(number, "begun" if number in self._open else "done")
        if number in self._let_go:
            self._let_go.discard(number)
            self._end.send(Kind.COMMAND, worded(Word.CANCEL, number), time.monotonic())

    def refuse(self, number: int, why: str) -> None:
        """A goal, or another command, was not done."""
        _log.warning("command %d refused: %s", number, why)
        self._fates.became(number, f"refused: {why}")
        if (found := self._open.pop(number, None)) is not None:
            place, handle = found
            self._servers[place].finish(handle, "abort", REFUSED[ACTIONS[place].type](why))

    def feedback(self, number: int, feedback: Any) -> Any:
        """Hand feedback to a goal; returns its id, None: there is no such goal."""
        if (found := self._open.get(number)) is None:
            return None
        found[1].publish_feedback(feedback)
        return found[1].goal_id

    def given_up(self, number: int) -> None:
        """Nothing has acknowledged it in time."""
        if number in self._open:
            self._let_go.add(number)
        self.refuse(number, "not acknowledged before its deadline")

    def end(self, number: int, content: bytes) -> None:
        """The robot's result.

        Raises:
            SealError: it is none.
        """
        if (found := self._open.pop(number, None)) is None:
            return
        place, handle = found
        result = self._deflated.unpack(content[1:], ACTIONS[place].type.Result)
        state = _STATES.get(content[0] if content else 0, "abort")
        self._fates.became(number, _TOLD[state])
        self._servers[place].finish(handle, state, result)

    def lose_all(self, why: str) -> None:
        """A session ended: what becomes of its goals is not told any more."""
        for number in list(self._open):
            self.refuse(number, why)
        self._let_go.clear()

    def close(self) -> None:
        """Take the servers away."""
        for server in self._servers:
            server.destroy()
