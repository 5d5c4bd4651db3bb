"""An action server whose goals end from outside: every goal that is accepted ends, and its result expires."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from action_msgs.msg import GoalStatus, GoalStatusArray
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient, CancelResponse

from harness.instance import RunningInstance
from harness.waiting import PATIENCE, wait_until
from valor.common.instance import Settings
from valor.ros import lateness
from valor.ros.deferred_action_server import DeferredActionServer
from valor.ros.node import ProcessNode, RosSide

NAME = "/arm/follow_joint_trajectory"
RESULT = FollowJointTrajectory.Result


@pytest.fixture
def side(instance: RunningInstance) -> Iterator[RosSide]:
    settings = Settings(robot=Path("escher"), ros_domain_id=instance.settings.ros_domain_id)
    made = RosSide("arm", settings, {}, (), node=lambda name, context: ProcessNode(name, context, True), sim_time=True)
    yield made
    made.close()


class Asked:
    """A server and a client on one node; callbacks run while somebody waits."""

    def __init__(self, side: RosSide, on_goal: Callable[[Any], None], on_late: Any = None) -> None:
        self._side = side
        self.server = DeferredActionServer(
            side.node, FollowJointTrajectory, NAME, on_goal, lambda _: CancelResponse.ACCEPT, on_late=on_late
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
    assert handle.accepted and asked.answer(handle.get_result_async()).status == GoalStatus.STATUS_ABORTED


def test_a_result_that_was_there_before_it_was_asked_for_is_had_and_by_several(side: RosSide) -> None:
    def end(handle: Any) -> None:
        asked.server.finish(handle, "abort", RESULT(error_string="taken"))

    asked = Asked(side, end)
    handle = asked.answer(asked.client.send_goal_async(FollowJointTrajectory.Goal()))
    for _ in range(3):
        answer = asked.answer(handle.get_result_async())
        assert (answer.status, answer.result.error_string) == (GoalStatus.STATUS_ABORTED, "taken")


@pytest.mark.parametrize("latest", [60.0, -1.0])
def test_a_late_goal_is_ended_with_the_reason(side: RosSide, monkeypatch: pytest.MonkeyPatch, latest: float) -> None:
    monkeypatch.setattr(lateness, "LATE", latest)
    asked: Asked = Asked(
        side,
        lambda handle: asked.server.finish(handle, "succeed", RESULT()),
        lambda handle, reason: asked.server.finish(handle, "abort", RESULT(error_string=reason)),
    )
    handle = asked.answer(asked.client.send_goal_async(FollowJointTrajectory.Goal()))
    answer = asked.answer(handle.get_result_async())
    late = latest < 0.0
    assert answer.status == (GoalStatus.STATUS_ABORTED if late else GoalStatus.STATUS_SUCCEEDED)
    assert ("s after it was sent" in answer.result.error_string) == late


class Counted(DeferredActionServer):
    waits = 0

    def add_to_wait_set(self, wait_set: Any) -> None:
        self.waits += 1
        super().add_to_wait_set(wait_set)


class Fast:
    """Robot time that runs fast beside a thread that spins, as in the Valor ROS Controller."""

    TICKS = 1000  # in 10 s

    def __init__(self, side: RosSide) -> None:
        self.node, self.now = side.node, 0
        self.server = Counted(side.node, FollowJointTrajectory, NAME, self._end, lambda _: CancelResponse.ACCEPT)
        self.client = ActionClient(side.node, FollowJointTrajectory, NAME)
        self.states: list[GoalStatusArray] = []
        side.node.create_subscription(GoalStatusArray, f"{NAME}/_action/status", self.states.append, 10)
        side.node.create_timer(0.1, lambda: None)  # on robot time: the wake-ups that there should be
        self.thread = threading.Thread(target=side.executor.spin)
        self.thread.start()
        wait_until(self.client.server_is_ready, PATIENCE, "the server")

    def _end(self, handle: Any) -> None:
        self.server.finish(handle, "succeed", RESULT())

    def goal(self) -> Any:
        sent = self.client.send_goal_async(FollowJointTrajectory.Goal())
        wait_until(sent.done, PATIENCE, "the goal's acceptance")
        result = sent.result().get_result_async()
        wait_until(result.done, PATIENCE, "the goal's result")
        return result.result()

    def advance(self) -> int:
        """Let 10 s of robot time pass; how often the executor waited."""
        before = self.server.waits
        for _ in range(self.TICKS):
            self.now += 10_000_000
            self.node.set_time(self.now)
            time.sleep(0.0005)  # the pace of time
        return self.server.waits - before


def test_a_result_is_kept_for_a_minute_of_robot_time_and_no_process_wakes_more_often_afterwards(side: RosSide) -> None:
    fast = Fast(side)
    try:
        early = fast.advance()
        for _ in range(20):
            assert fast.goal().status == GoalStatus.STATUS_SUCCEEDED
        for _ in range(5):
            fast.advance()
        assert len(fast.server._goal_handles) == 20
        for _ in range(6):
            fast.advance()
        assert fast.advance() <= 1.25 * early + 5
        wait_until(lambda: not fast.server._goal_handles and not fast.server._result_futures, PATIENCE, "expiry")
        fast.states.clear()
        fast.goal()
        [left] = wait_until(lambda: fast.states, PATIENCE, "the states of the goals")[-1].status_list
        assert (left.goal_info.stamp.sec, left.goal_info.stamp.nanosec) == divmod(fast.now, 1_000_000_000)
    finally:
        side.executor.shutdown()
        fast.thread.join()
