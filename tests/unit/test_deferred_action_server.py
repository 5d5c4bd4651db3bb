"""An action server whose goals end from outside: every goal that is accepted ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient, CancelResponse

from harness.instance import RunningInstance
from harness.waiting import PATIENCE, wait_until
from valor.common.instance import Settings
from valor.ros.deferred_action_server import DeferredActionServer
from valor.ros.node import RosSide

NAME = "/arm/follow_joint_trajectory"
RESULT = FollowJointTrajectory.Result


@pytest.fixture
def side(instance: RunningInstance) -> Iterator[RosSide]:
    made = RosSide("arm", Settings(robot=Path("escher"), ros_domain_id=instance.settings.ros_domain_id), {}, ())
    yield made
    made.close()


class Asked:
    """A server and a client on one node; callbacks run while somebody waits."""

    def __init__(self, side: RosSide, on_goal: Callable[[Any], None]) -> None:
        self._side = side
        self.server = DeferredActionServer(
            side.node, FollowJointTrajectory, NAME, on_goal, lambda _: CancelResponse.ACCEPT
        )
        self.client = ActionClient(side.node, FollowJointTrajectory, NAME)
        wait_until(lambda: self._spun(self.client.server_is_ready()), PATIENCE, "the server")

    def answer(self, future: Any) -> Any:
        wait_until(lambda: self._spun(future.done()), PATIENCE, "an answer")
        return future.result()

    def _spun(self, said: bool) -> bool:
        with suppress(ZeroDivisionError):  # as a process' thread does, it goes on
            self._side.executor.spin_once(timeout_sec=0.01)
        return said


def test_a_goal_that_its_owner_cannot_take_is_aborted(side: RosSide) -> None:
    asked = Asked(side, lambda _: 1 // 0)  # type: ignore[arg-type]
    handle = asked.answer(asked.client.send_goal_async(FollowJointTrajectory.Goal()))
    assert handle.accepted
    assert asked.answer(handle.get_result_async()).status == GoalStatus.STATUS_ABORTED


def test_a_result_that_was_there_before_it_was_asked_for_is_had_and_by_several(side: RosSide) -> None:
    def end(handle: Any) -> None:
        asked.server.finish(handle, "abort", RESULT(error_string="taken"))

    asked = Asked(side, end)
    handle = asked.answer(asked.client.send_goal_async(FollowJointTrajectory.Goal()))
    for _ in range(3):
        answer = asked.answer(handle.get_result_async())
        assert (answer.status, answer.result.error_string) == (GoalStatus.STATUS_ABORTED, "taken")
