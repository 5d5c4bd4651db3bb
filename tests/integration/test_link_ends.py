"""Both ends as processes between two ROS domains, with somebody in the robot's place who answers as told."""

from __future__ import annotations

import contextlib
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import Twist
from sensor_msgs.msg import JointState
from vigir_humanoid_control_msgs.action import ChangeControlMode

import bifrost
from harness.instance import RunningInstance
from harness.places import ROBOTS
from harness.system import RosClient
from harness.waiting import wait_until
from valor.common import membership
from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.common.messages import ModeStatus
from valor.common.stopping import HALT, LOCK
from valor.common.table import checked
from valor.common.viewing import LOOPBACK
from valor.link.classes import BY_KIND, Kind
from valor.link.fields import BY_NAME
from valor.robot.description import RobotDescription
from valor.ros.lateness import LATE
from valor.valorctl import beyond_link, middleware
from valor.valorctl.ros_domain import daemon_ports, reserve, reserve_for

MODES = "mode_controllers/control_mode_controller/change_control_mode"
PATIENCE = 150.0  # [s]


@dataclass
class Robot:
    """Serves the control modes; ends a goal when told, or when it is canceled."""

    asked: list[str] = field(default_factory=list)
    ends: threading.Event = field(default_factory=threading.Event)
    canceled: list[str] = field(default_factory=list)
    under_way: set[int] = field(default_factory=set)

    def execute(self, handle: Any) -> Any:
        self.under_way.add(id(handle))
        try:
            return self._execute(handle)
        finally:
            self.under_way.discard(id(handle))

    def _execute(self, handle: Any) -> Any:
        self.asked.append(handle.request.mode_request)
        result = ChangeControlMode.Result()
        wait_until(lambda: self.ends.is_set() or handle.is_cancel_requested, PATIENCE, "to be told how the goal ends")
        if handle.is_cancel_requested:
            self.canceled.append(handle.request.mode_request)
            handle.canceled()
            return result
        result.result.status = int(ModeStatus.MODE_ACCEPTED)
        result.result.current_control_mode = handle.request.mode_request
        handle.succeed()
        return result


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[RunningInstance, int]]:
    """An instance of nothing but the link, and the operator's domain."""
    made = Instance("link_ends", tmp_path_factory.mktemp("home"))
    made.logs.mkdir(parents=True)
    with reserve_for(made) as reservation, reserve("link_ends_operator", {reservation.domain}) as theirs:
        settings = {"robot": str(ROBOTS / "escher"), "ros_domain_id": reservation.domain,
                    "port_block": reservation.domain, "link": {"domain": theirs.domain}}  # fmt: skip
        made.settings_file.write_text(checked(Settings, settings).json())
        network = bifrost.Network.create(
            made.network_file, made.keys, ports=daemon_ports(reservation.domain), charter=membership.charter(made)
        )
        instance = RunningInstance(made, network)
        try:
            for name in ("bifrostd", "link_robot", "link_operator"):
                instance.start(name, env={"BIFROST_OWNERS": str(made.owners)})
            yield instance, theirs.domain
        finally:
            instance.close()


@pytest.fixture(scope="module")
def sides(running: tuple[RunningInstance, int]) -> Iterator[tuple[Robot, RosClient, RosClient]]:
    """Who answers in the robot's place, a client beside, and one in the operator's domain."""
    import rclpy
    from rclpy.action import ActionServer, CancelResponse
    from rclpy.executors import MultiThreadedExecutor

    instance, domain = running
    environment = instance.instance.environment()
    beside, operator = (
        RosClient(each, joint_states=False) for each in (environment, environment | {"ROS_DOMAIN_ID": str(domain)})
    )
    robot, context = Robot(), rclpy.Context()
    rclpy.init(context=context, domain_id=int(environment["ROS_DOMAIN_ID"]))
    node = rclpy.create_node("in_the_robots_place", context=context)
    server = ActionServer(
        node, ChangeControlMode, MODES, robot.execute, cancel_callback=lambda _: CancelResponse.ACCEPT
    )
    executor = MultiThreadedExecutor(4, context=context)
    executor.add_node(node)
    over = threading.Event()

    def spin() -> None:
        while not over.is_set():
            executor.spin_once(timeout_sec=0.1)

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    yield robot, beside, operator
    robot.ends.set()
    wait_until(lambda: not robot.under_way, PATIENCE, "the goals to end")  # before their executor: each tells it so
    over.set()
    thread.join(10.0)
    executor.shutdown()
    server.destroy()
    node.destroy_node()
    context.try_shutdown()
    operator.close()
    beside.close()


def _goal(operator: RosClient, mode: str) -> Any:
    """The handle of a goal."""
    client = operator._mode
    assert client.wait_for_server(timeout_sec=PATIENCE)
    goal = ChangeControlMode.Goal(mode_request=mode)
    return operator._wait(operator._call(client.send_goal_async, goal), PATIENCE, mode)


def _told(operator: RosClient) -> list[Any]:
    """What ``/link/status`` tells from now on."""
    from diagnostic_msgs.msg import DiagnosticStatus

    told: list[Any] = []
    operator._call(operator.node.create_subscription, DiagnosticStatus, "link/status", told.append, 10)
    return told


def _commands(told: list[Any]) -> list[str]:
    """What became of each, the newest first."""
    values = {pair.key: pair.value for pair in told[-1].values} if told else {}
    return [value for key, value in values.items() if "command" in key and not key.startswith(("sent", "heard"))]


def test_what_nobody_serves_is_refused_with_the_reason(sides: tuple[Robot, RosClient, RosClient]) -> None:
    _, _, operator = sides
    told: list[str] = []

    def refused() -> bool:
        result = operator.follow("neck", [(1.0, {"any": 0.0})], PATIENCE).result
        assert result.error_code != 0
        told.append(result.error_string)
        return "not been heard" not in told[-1]

    wait_until(refused, PATIENCE, "the ends to hear each other")
    assert "nobody serves" in told[-1]


def test_a_goal_ends_at_the_operators_as_at_the_robots(sides: tuple[Robot, RosClient, RosClient]) -> None:
    robot, _, operator = sides
    robot.ends.set()

    def accepted() -> bool:
        """Whether it is; where the robot's end has not found who serves the modes yet, it is refused."""
        return bool(operator.change_mode("walk", PATIENCE).status == ModeStatus.MODE_ACCEPTED)

    wait_until(accepted, PATIENCE, "the mode to be accepted")
    assert robot.asked == ["walk"]
    robot.ends.clear()


def test_how_long_ago_a_velocity_came_through_is_told(sides: tuple[Robot, RosClient, RosClient]) -> None:
    _, beside, operator = sides
    velocities: list[Any] = []
    beside._call(beside.node.create_subscription, Twist, "cmd_vel", velocities.append, 10)
    joints = RobotDescription.load(ROBOTS / "escher").joints
    states = beside._call(beside.node.create_publisher, JointState, "joint_states", 10)
    still = partial(states.publish, JointState(name=list(joints), position=[0.0] * len(joints)))
    timer = beside._call(beside.node.create_timer, 0.1, still)
    told = _told(operator)
    wait_until(lambda: _age(told) == math.inf, PATIENCE, "none to have come")
    publisher = operator._call(operator.node.create_publisher, Twist, "cmd_vel", 1)
    wait_until(publisher.get_subscription_count, PATIENCE, "the link to listen")

    def comes() -> bool:
        publisher.publish(Twist())
        return bool(velocities) and _age(told) < BY_NAME["velocity_age"].high

    wait_until(comes, PATIENCE, "a velocity to come through", period=0.1)
    wait_until(lambda: _age(told) == math.inf, PATIENCE, "the last to be long ago")
    beside.destroy(beside.node.destroy_timer, timer)


def _age(told: list[Any]) -> float:
    """Of the newest velocity that came through, as told [s]; −1: not told."""
    return float({pair.key: pair.value for pair in told[-1].values}.get("velocity_age", -1.0)) if told else -1.0


def test_a_cancellation_goes_through_it(sides: tuple[Robot, RosClient, RosClient]) -> None:
    robot, _, operator = sides
    handle = _goal(operator, "step")
    wait_until(lambda: "step" in robot.asked, PATIENCE, "the goal to begin")
    operator._call(handle.cancel_goal_async)
    told = operator._wait(operator._call(handle.get_result_async), PATIENCE, "the goal to end")
    assert told.status == GoalStatus.STATUS_CANCELED and robot.canceled == ["step"]


def test_a_stop_is_one_message_and_comes_once(sides: tuple[Robot, RosClient, RosClient]) -> None:
    from std_msgs.msg import Empty

    _, beside, operator = sides
    stops: list[Any] = []
    beside._call(beside.node.create_subscription, Empty, "flor/controller/soft_stop", stops.append, 10)
    publisher = operator._call(operator.node.create_publisher, Empty, "flor/controller/soft_stop", 1)

    deadline = BY_KIND[Kind.STOP].deadline or 0.0

    def arrives() -> bool:
        """Whether one comes through; one that comes before all have found each other has nobody to come to."""
        publisher.publish(Empty())
        until = time.monotonic() + deadline
        wait_until(lambda: stops or time.monotonic() > until, deadline, "the stop, or its deadline")
        return bool(stops)

    wait_until(arrives, 6 * deadline, "a stop to come through")
    told = _told(operator)
    for _ in range(2):
        wait_until(lambda: _commands(told) and "on its way" not in "".join(_commands(told)), PATIENCE, "all to be done")
        before = len(stops)
        publisher.publish(Empty())
        wait_until(lambda before=before: len(stops) > before, PATIENCE, "another")  # type: ignore[misc]
        assert len(stops) == before + 1
        del told[:]


def test_how_a_plan_and_a_hand_fare_is_told_as_there(sides: tuple[Robot, RosClient, RosClient]) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from valor_msgs.msg import HandGoalStatus
    from vigir_footstep_planning_msgs.msg import Step

    from valor.ros.progress import FEEDBACK, GOAL_STATUS, FeedbackMessage

    _, beside, operator = sides
    latched = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    plans: list[Any] = []
    hands: list[Any] = []
    operator._call(operator.node.create_subscription, FeedbackMessage, FEEDBACK, plans.append, latched)
    topic = GOAL_STATUS.format("r_hand")
    operator._call(operator.node.create_subscription, HandGoalStatus, topic, hands.append, latched)
    sent = FeedbackMessage()
    sent.feedback.header.frame_id = sent.feedback.feedback.header.frame_id = "odom"
    sent.feedback.feedback.steps = [Step(step_index=index, valid=True) for index in range(3)]
    sent.feedback.status.error_msg = "step 2: too far"
    beside._call(beside.node.create_publisher, FeedbackMessage, FEEDBACK, latched).publish(sent)
    status = HandGoalStatus(hand=1, state="out_of_reach", reason="too far", position_error=0.25)
    beside._call(beside.node.create_publisher, HandGoalStatus, topic, latched).publish(status)
    wait_until(lambda: plans and plans[-1].feedback == sent.feedback, PATIENCE, "the plan to be told")
    wait_until(lambda: hands and hands[-1] == status, PATIENCE, "the hand to be told")


def test_what_became_of_each_command_is_told(sides: tuple[Robot, RosClient, RosClient]) -> None:
    from std_msgs.msg import Empty

    _, beside, operator = sides
    told = _told(operator)
    releases: list[Any] = []
    topic = "flor/l_hand/goal_cancel"
    beside._call(beside.node.create_subscription, Empty, topic, releases.append, 10)
    publisher = operator._call(operator.node.create_publisher, Empty, topic, 1)
    again = 0.0

    def comes() -> bool:
        """Whether it comes through; one that comes before all have found each other has nobody to come to."""
        nonlocal again
        if time.monotonic() > again:
            publisher.publish(Empty())
            again = time.monotonic() + 5.0
        return bool(releases)

    wait_until(comes, PATIENCE, "it to be obeyed")
    wait_until(lambda: _commands(told)[:1] and _commands(told)[0].startswith("goal_cancel: done"), PATIENCE, "that")


def test_verbs_on_the_operators_side_see_and_stop_the_robot(
    running: tuple[RunningInstance, int], sides: tuple[Robot, RosClient, RosClient], tmp_path: Path
) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import Empty
    from valor_msgs.msg import MotionState
    from vigir_humanoid_control_msgs.msg import ControlModeStatus

    desk = Instance("desk", tmp_path)
    desk.folder.mkdir(parents=True)
    desk.settings_file.write_text(Settings(robot=ROBOTS / "escher", ros_domain_id=running[1]).json())
    joints = RobotDescription.load(ROBOTS / "escher").joints
    robot, beside, _ = sides
    stops: list[Any] = []
    beside._call(beside.node.create_subscription, Empty, "flor/controller/soft_stop", stops.append, 10)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publishers = [
        beside._call(beside.node.create_publisher, kind, topic, qos)
        for kind, topic, qos in ((JointState, "joint_states", 10), (MotionState, "flor/controller/motion_state", 10),
                                 (ControlModeStatus, "flor/controller/mode", latched))
    ]  # fmt: skip

    def tell() -> None:
        """As a robot that stands until it is stopped."""
        state = "freeze" if "freeze" in robot.asked else "soft_stop" if stops else "stand"
        messages = (JointState(name=list(joints), position=[0.25] * len(joints)), MotionState(behavior=state),
                    ControlModeStatus(current_control_mode=state))  # fmt: skip
        for publisher, message in zip(publishers, messages, strict=True):
            publisher.publish(message)

    timer = beside._call(beside.node.create_timer, 0.1, tell)

    def asked(what: Callable[[], Any]) -> Any:
        """What a verb gives; nothing: it gave up, and is to be asked again."""
        with contextlib.suppress(ValorError):
            return what()

    def positions() -> dict[str, float]:
        with beyond_link.joints(desk) as heard:
            return heard()

    told = wait_until(lambda: asked(positions), PATIENCE, "the joints")
    assert set(told) == set(joints) and max(abs(each - 0.25) for each in told.values()) <= 0.001 + 1e-9

    def stands() -> bool:
        report, age = asked(lambda: beyond_link.mode(desk)) or (None, 0.0)
        return bool(report and report.current_control_mode == report.behavior == "stand" and 0.0 < age < PATIENCE)

    wait_until(stands, PATIENCE, "the mode, and how old it is")

    def stopped() -> bool:
        state, _, seen, (path,) = asked(lambda: beyond_link.stop(desk, HALT, lambda: None)) or ("", 0.0, "", ("",))
        assert state in ("", "soft_stop"), (seen, path)
        return bool(state)

    wait_until(stopped, PATIENCE, "the robot's word that it has stopped")
    assert stops
    robot.ends.set()
    told_stop = wait_until(lambda: asked(lambda: beyond_link.stop(desk, LOCK, lambda: None)), PATIENCE, "an answer")
    assert told_stop[0] == "freeze" and told_stop[3][0].answer == "control mode freeze"
    assert robot.asked.count("freeze") >= 1
    robot.ends.clear()
    beside.destroy(beside.node.destroy_timer, timer)


def test_goals_of_an_end_that_died_are_not_left_open(
    running: tuple[RunningInstance, int], sides: tuple[Robot, RosClient, RosClient]
) -> None:
    robot, _, operator = sides
    handle = _goal(operator, "manipulate")
    wait_until(lambda: "manipulate" in robot.asked, PATIENCE, "the goal to begin")
    running[0].kill("link_robot")
    running[0].start("link_robot", env={"BIFROST_OWNERS": str(running[0].instance.owners)})
    told = operator._wait(operator._call(handle.get_result_async), PATIENCE, "the goal to end")
    assert told.result.result.status & ModeStatus.MODE_REJECTED
    assert robot.asked.count("manipulate") == 1


def test_a_goal_that_came_late_to_the_operators_end_is_refused_there(
    running: tuple[RunningInstance, int], sides: tuple[Robot, RosClient, RosClient]
) -> None:
    (robot, _, operator), instance = sides, running[0]
    instance.stop("link_operator")
    instance.instance.middleware_file.write_text(middleware.profile([LOOPBACK]))
    instance.configure(peers=(LOOPBACK,))  # where other computers command
    instance.start("link_operator", env={"BIFROST_OWNERS": str(instance.instance.owners)})
    robot.ends.set()
    wait_until(lambda: operator.change_mode("walk").status == ModeStatus.MODE_ACCEPTED, PATIENCE, "one to be obeyed")
    asked, told = len(robot.asked), _told(operator)
    process = instance.process("link_operator")
    process.send_signal(signal.SIGSTOP)
    sent = operator._call(operator._mode.send_goal_async, ChangeControlMode.Goal(mode_request="late"))
    time.sleep(LATE + 0.5)  # the time on its way itself
    process.send_signal(signal.SIGCONT)
    handle = operator._wait(sent, PATIENCE, "the goal to be answered")
    ended = operator._wait(operator._call(handle.get_result_async), PATIENCE, "the goal to end")
    assert ended.status == GoalStatus.STATUS_ABORTED and ended.result.result.status & ModeStatus.MODE_REJECTED
    wait_until(lambda: any("s after it was sent" in each for each in _commands(told)), PATIENCE, "that it came late")
    assert len(robot.asked) == asked
