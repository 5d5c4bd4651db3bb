"""What the operator station sends over ROS 2, to servers that answer, refuse, keep silent, or are not there."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import Twist
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from vigir_humanoid_control_msgs.action import ChangeControlMode

from harness.instance import RunningInstance, fresh_instance
from harness.waiting import PATIENCE, wait_until
from valor.common.errors import RefusalError
from valor.common.messages import ModeStatus
from valor.operator_station.commands.commander import ANSWER, MODE, Commander
from valor.operator_station.commands.log import Command, CommandLog


class Server:
    """Of the control modes: does with a goal as it is told; hears ``/cmd_vel``."""

    def __init__(self, node: Any) -> None:
        self.accepts = GoalResponse.ACCEPT
        self.waits = threading.Event()  # before it answers a goal
        self.ends = threading.Event()
        for event in (self.waits, self.ends):
            event.set()
        self.status = ModeStatus.MODE_ACCEPTED
        self.asked: list[str] = []
        self.cancelled = threading.Event()
        self.velocities: list[float] = []
        node.create_subscription(Twist, "/cmd_vel", lambda twist: self.velocities.append(twist.linear.x), 10)
        self.action = ActionServer(
            node, ChangeControlMode, MODE, self._execute, goal_callback=self._goal, cancel_callback=self._cancel
        )

    def _goal(self, goal: Any) -> GoalResponse:
        self.waits.wait(PATIENCE)
        self.asked.append(goal.mode_request)
        return self.accepts

    def _cancel(self, _: Any) -> CancelResponse:
        self.cancelled.set()
        return CancelResponse.ACCEPT

    def _execute(self, handle: Any) -> Any:
        self.ends.wait(PATIENCE)
        result = ChangeControlMode.Result()
        result.result.status, result.result.current_control_mode = int(self.status), handle.request.mode_request
        if handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.succeed()
        return result


@pytest.fixture(scope="module")
def instance(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningInstance]:
    with fresh_instance(tmp_path_factory.mktemp("home"), "commands") as instance:
        yield instance


@pytest.fixture(scope="module")
def context(instance: RunningInstance) -> Iterator[Any]:
    with pytest.MonkeyPatch.context() as patch:
        for name, value in instance.instance.environment().items():
            patch.setenv(name, value)  # read by the middleware's C++ when it starts
        context = rclpy.Context()
        domain = instance.settings.ros_domain_id
        rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        yield context
        context.try_shutdown()


@pytest.fixture(scope="module")
def commander(context: Any) -> Iterator[Commander]:
    node = rclpy.create_node("commander", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    commander = Commander(node, executor, ["left_arm"])
    commander.start()
    yield commander
    commander.close()
    executor.shutdown()
    node.destroy_node()


@pytest.fixture(scope="module")
def server(context: Any, commander: Commander) -> Iterator[Server]:
    node = rclpy.create_node("robot", context=context)
    server = Server(node)
    executor = MultiThreadedExecutor(4, context=context)
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin, daemon=True)
    thread.start()
    wait_until(commander._modes.server_is_ready, PATIENCE, "the server is found")
    yield server
    executor.shutdown()
    thread.join()
    node.destroy_node()


LOG = CommandLog()


def command(text: str) -> Command:
    return LOG.begin(text, "Ann", 0.0, 1.0)


def test_nothing_is_sent_to_nobody_nor_kept_for_them(commander: Commander) -> None:
    absent = command("mode stand")
    with pytest.raises(RefusalError, match=f"nobody serves {MODE}"):
        commander.change_mode("stand", absent)
    assert absent.state == "refused"
    commander.velocity(0.5, 0.0, 0.0)


def test_a_goal_is_acknowledged_then_done(commander: Commander, server: Server) -> None:
    assert server.asked == []
    wait_until(lambda: commander._velocity.get_subscription_count() > 0, PATIENCE, "the velocity has a subscriber")
    commander.velocity(0.25, 0.0, 0.0)
    wait_until(lambda: bool(server.velocities), PATIENCE, "the velocity arrives")
    assert server.velocities == [0.25], "what was sent before is not repeated"
    then = threading.Event()
    done = command("mode walk")
    server.ends.clear()
    commander.change_mode("walk", done, then=then.set)
    wait_until(lambda: done.state == "acknowledged", PATIENCE, "it is acknowledged")
    commander.expire(time.monotonic() + ANSWER + 1.0)
    assert done.state == "acknowledged"
    server.ends.set()
    wait_until(lambda: done.state == "done", PATIENCE, "it is done")
    assert then.is_set() and server.asked == ["walk"]


def test_refusals_come_with_their_flags(commander: Commander, server: Server) -> None:
    server.status = ModeStatus.MODE_REJECTED | ModeStatus.ERR_INVALID_TRANSITION
    refused = command("mode stand")
    commander.change_mode("stand", refused, then=lambda: pytest.fail("the mode was not reached"))
    wait_until(lambda: refused.state == "refused", PATIENCE, "it is refused")
    assert "ERR_INVALID_TRANSITION" in refused.answer
    server.status, server.accepts = ModeStatus.MODE_ACCEPTED, GoalResponse.REJECT
    rejected = command("mode stand")
    commander.change_mode("stand", rejected)
    wait_until(lambda: rejected.state == "refused", PATIENCE, "it is rejected")
    server.accepts = GoalResponse.ACCEPT


def test_what_is_acknowledged_too_late_is_given_up_and_cancelled(commander: Commander, server: Server) -> None:
    server.waits.clear()
    server.ends.clear()
    late = command("mode step")
    commander.change_mode("step", late, then=lambda: pytest.fail("it had been given up"))
    commander.expire(time.monotonic() + ANSWER + 1.0)
    assert late.state == "refused" and "given up" in late.answer
    server.waits.set()
    assert server.cancelled.wait(PATIENCE), "accepted after all, it is cancelled"
    server.ends.set()
    assert late.state == "refused"
