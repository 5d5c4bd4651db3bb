"""What the operator station sends over ROS 2, to servers that answer, refuse, keep silent, or are not there."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import Twist
from lifecycle_msgs.srv import GetState
from rcl_interfaces.msg import Log
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from vigir_humanoid_control_msgs.action import ChangeControlMode

from harness.instance import RunningInstance, fresh_instance
from valor.common.errors import RefusalError
from valor.common.messages import ModeStatus
from valor.operator_station.commander import ANSWER, MODE, Commander
from valor.operator_station.commands import Command, CommandLog

PATIENCE = 60.0  # [s]


class Server:
    """Of the control modes: does with a goal as it is told; hears ``/cmd_vel``."""

    def __init__(self, node: Any) -> None:
        self.accepts = GoalResponse.ACCEPT
        self.waits = threading.Event()  # before it answers a goal
        self.waits.set()
        self.status = ModeStatus.MODE_ACCEPTED
        self.asked: list[str] = []
        self.cancelled = threading.Event()
        self.velocities: list[float] = []
        self.ends = threading.Event()
        self.ends.set()
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
    until(commander._modes.server_is_ready, "the server is found")
    yield server
    executor.shutdown()
    thread.join()
    node.destroy_node()


LOG = CommandLog()


def command(text: str) -> Command:
    return LOG.begin(text, "Ann", 0.0, time.monotonic(), 1.0)


def until(what: Callable[[], bool], name: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not what():
        assert time.monotonic() < deadline, name
        time.sleep(0.01)


def test_nothing_is_sent_to_nobody_nor_kept_for_them(commander: Commander) -> None:
    absent = command("mode stand")
    with pytest.raises(RefusalError, match=f"nobody serves {MODE}"):
        commander.change_mode("stand", absent)
    assert absent.state == "refused"
    commander.velocity(0.5, 0.0, 0.0)


def test_a_goal_is_acknowledged_then_done(commander: Commander, server: Server) -> None:
    assert server.asked == []
    assert server.velocities == [], "what was said before it came is not repeated"
    then = threading.Event()
    done = command("mode walk")
    server.ends.clear()
    commander.change_mode("walk", done, then=then.set)
    until(lambda: done.state == "acknowledged", "it is acknowledged")
    commander.expire(time.monotonic() + ANSWER + 1.0)
    assert done.state == "acknowledged"
    server.ends.set()
    until(lambda: done.state == "done", "it is done")
    assert then.is_set()
    assert server.asked == ["walk"]


def test_refusals_come_with_their_flags(commander: Commander, server: Server) -> None:
    server.status = ModeStatus.MODE_REJECTED | ModeStatus.ERR_INVALID_TRANSITION
    refused = command("mode stand")
    commander.change_mode("stand", refused, then=lambda: pytest.fail("the mode was not reached"))
    until(lambda: refused.state == "refused", "it is refused")
    assert "ERR_INVALID_TRANSITION" in refused.answer
    server.status, server.accepts = ModeStatus.MODE_ACCEPTED, GoalResponse.REJECT
    rejected = command("mode stand")
    commander.change_mode("stand", rejected)
    until(lambda: rejected.state == "refused", "it is rejected")
    server.accepts = GoalResponse.ACCEPT


def test_what_is_acknowledged_too_late_is_given_up_and_cancelled(commander: Commander, server: Server) -> None:
    server.waits.clear()
    server.ends.clear()
    late = command("mode step")
    commander.change_mode("step", late, then=lambda: pytest.fail("it had been given up"))
    commander.expire(time.monotonic() + ANSWER + 1.0)
    assert late.state == "refused"
    assert "given up" in late.answer
    server.waits.set()
    assert server.cancelled.wait(PATIENCE), "accepted after all, it is cancelled"
    server.ends.set()
    assert late.state == "refused"


def test_velocities_are_sent_once_each(commander: Commander, server: Server) -> None:
    until(lambda: commander._velocity.get_subscription_count() > 0, "somebody hears")
    commander.velocity(0.25, 0.0, 0.0)
    until(lambda: bool(server.velocities), "it is heard")
    assert server.velocities == [0.25]


def test_the_station_is_a_node_as_the_others_are(instance: RunningInstance, context: Any) -> None:
    instance.instance.operator_token.write_text("open sesame")
    told: list[str] = []
    node = rclpy.create_node("observer", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    node.create_subscription(
        Log, "/rosout", lambda line: told.append(line.msg) if line.name == "operator_station" else None,
        QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    )  # fmt: skip
    life = node.create_client(GetState, "/operator_station/get_state")
    instance.start("operator_station")
    instance.wait_ready("operator_station", PATIENCE)
    deadline, label = time.monotonic() + PATIENCE, ""
    while label != "active" or not any("http://" in line for line in told):
        assert time.monotonic() < deadline, (label, told)
        asked = life.call_async(GetState.Request())
        executor.spin_until_future_complete(asked, 1.0)
        label = asked.result().current_state.label if asked.done() else ""
    assert instance.stop("operator_station") == 0
    executor.shutdown()
    node.destroy_node()
