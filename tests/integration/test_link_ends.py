"""Both ends as processes between two ROS domains, with somebody in the robot's place who answers as told."""

from __future__ import annotations

import random
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.action import ActionServer, CancelResponse
from rclpy.executors import MultiThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, JointState
from std_msgs.msg import Empty
from vigir_humanoid_control_msgs.action import ChangeControlMode

import bifrost
from harness.instance import RunningInstance
from harness.places import ROBOTS
from harness.system import RosClient
from harness.waiting import wait_until
from valor.common import topics
from valor.common.instance import Instance, Settings
from valor.common.linking import PICTURE
from valor.common.messages import ModeStatus
from valor.common.table import checked
from valor.common.viewing import LOOPBACK
from valor.link.classes import BY_CLASS, MessageClass
from valor.robot.description import RobotDescription
from valor.ros.lateness import LATE
from valor.valorctl.instance import ros_domain
from valor.valorctl.instance.ros_domain import daemon_ports, reserve, reserve_for

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
            made.network_file, made.keys, ports=daemon_ports(reservation.domain), policy=topics.access_policy(made)
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
    client = operator._mode
    assert client.wait_for_server(timeout_sec=PATIENCE)
    goal = ChangeControlMode.Goal(mode_request=mode)
    return operator._wait(operator._call(client.send_goal_async, goal), PATIENCE, mode)


def _told(operator: RosClient) -> list[Any]:
    """What ``/link/status`` tells from now on."""
    told: list[Any] = []
    operator._call(operator.node.create_subscription, DiagnosticStatus, "link/status", told.append, 10)
    return told


def _commands(told: list[Any]) -> list[str]:
    """What became of each, the newest first."""
    values = {pair.key: pair.value for pair in told[-1].values} if told else {}
    return [value for key, value in values.items() if "command" in key and not key.startswith(("sent", "received"))]


def test_what_nobody_serves_is_refused_with_the_reason(sides: tuple[Robot, RosClient, RosClient]) -> None:
    _, _, operator = sides

    def refused() -> bool:
        """Whether the reason is the final one; until the ends are connected the rejection has another."""
        result = operator.follow("neck", [(1.0, {"any": 0.0})], PATIENCE).result
        assert result.error_code != 0
        return "no action server" in result.error_string

    wait_until(refused, PATIENCE, "a rejection for the missing action server")


def test_a_goal_ends_at_the_operators_as_at_the_robots(sides: tuple[Robot, RosClient, RosClient]) -> None:
    robot, _, operator = sides
    robot.ends.set()

    def accepted() -> bool:
        """Whether it is; where the robot's end has not found who serves the modes yet, it is refused."""
        return bool(operator.change_mode("walk", PATIENCE).status == ModeStatus.MODE_ACCEPTED)

    wait_until(accepted, PATIENCE, "the mode to be accepted")
    assert robot.asked == ["walk"]
    robot.ends.clear()


def test_a_cancellation_goes_through_it(sides: tuple[Robot, RosClient, RosClient]) -> None:
    robot, _, operator = sides
    handle = _goal(operator, "step")
    wait_until(lambda: "step" in robot.asked, PATIENCE, "the goal to begin")
    operator._call(handle.cancel_goal_async)
    told = operator._wait(operator._call(handle.get_result_async), PATIENCE, "the goal to end")
    assert told.status == GoalStatus.STATUS_CANCELED and robot.canceled == ["step"]


def test_a_stop_is_one_message_and_comes_once(sides: tuple[Robot, RosClient, RosClient]) -> None:
    _, beside, operator = sides
    stops: list[Any] = []
    beside._call(beside.node.create_subscription, Empty, "flor/controller/soft_stop", stops.append, 10)
    publisher = operator._call(operator.node.create_publisher, Empty, "flor/controller/soft_stop", 1)

    deadline = BY_CLASS[MessageClass.STOP].deadline or 0.0

    def arrives() -> bool:
        """Whether one comes through; one that comes before all have found each other has nobody to come to."""
        publisher.publish(Empty())
        until = time.monotonic() + deadline
        wait_until(lambda: stops or time.monotonic() > until, deadline, "the stop, or its deadline")
        return bool(stops)

    wait_until(arrives, 6 * deadline, "a stop to come through")
    told = _told(operator)
    for _ in range(2):
        wait_until(lambda: _commands(told) and "pending" not in "".join(_commands(told)), PATIENCE, "all to be done")
        before = len(stops)
        publisher.publish(Empty())
        wait_until(lambda before=before: len(stops) > before, PATIENCE, "another")  # type: ignore[misc]
        assert len(stops) == before + 1
        del told[:]


def test_the_latest_picture_comes_over_the_fast_channel_with_its_age(
    running: tuple[RunningInstance, int], sides: tuple[Robot, RosClient, RosClient]
) -> None:
    _, beside, operator = sides
    pictures: list[Any] = []
    ages: list[float] = []

    def store_age(message: DiagnosticStatus) -> None:
        ages.extend(float(pair.value) for pair in message.values if pair.key == "picture_age")

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    operator._call(operator.node.create_subscription, CompressedImage, PICTURE, pictures.append, latched)
    operator._call(operator.node.create_subscription, DiagnosticStatus, "link/status", store_age, latched)
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    topic = running[0].settings.link.picture
    publisher = beside._call(beside.node.create_publisher, CompressedImage, topic, best_effort)
    message = CompressedImage(format="jpeg", data=random.Random(0).randbytes(60_000))
    message.header.frame_id = "camera"
    joints = list(RobotDescription.load(ROBOTS / "escher").joints)
    states = beside._call(beside.node.create_publisher, JointState, "joint_states", 10)
    state = JointState(name=joints, position=[0.0] * len(joints))  # without a state the link has no status

    def publish() -> None:
        publisher.publish(message)
        states.publish(state)

    timer = beside._call(beside.node.create_timer, 0.5, publish)
    wait_until(lambda: pictures and ages, PATIENCE, "a picture and its age")
    beside._call(timer.cancel)
    picture = pictures[-1]
    assert picture.data == message.data and (picture.format, picture.header.frame_id) == ("jpeg", "camera")
    wait_until(lambda: len(ages) > 10 and ages[-1] > ages[-10], PATIENCE, "an age that grows without new pictures")


def test_goals_of_a_dead_end_are_closed(
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


def test_a_goal_received_with_a_stop_is_rejected(sides: tuple[Robot, RosClient, RosClient]) -> None:
    """DDS keeps no order between the two: a goal sent before the stop may be taken after it."""
    robot, _, operator = sides
    robot.ends.set()
    wait_until(lambda: operator.change_mode("walk").status == ModeStatus.MODE_ACCEPTED, PATIENCE, "one to be obeyed")
    publisher = operator._call(operator.node.create_publisher, Empty, "flor/controller/soft_stop", 1)
    wait_until(publisher.get_subscription_count, PATIENCE, "the stop's subscriber")

    told = _told(operator)

    def rejected() -> bool:
        operator._call(publisher.publish, Empty())
        handle = _goal(operator, "step")
        operator._wait(operator._call(handle.get_result_async), PATIENCE, "the goal to end")
        return any("together with a stop" in each for each in _commands(told))  # a goal taken before it is not

    wait_until(rejected, PATIENCE / 5, "a goal taken after a stop to be rejected")
    wait_until(lambda: operator.change_mode("walk").status == ModeStatus.MODE_ACCEPTED, PATIENCE, "a later one")


def test_a_goal_that_came_late_to_the_operators_end_is_refused_there(
    running: tuple[RunningInstance, int], sides: tuple[Robot, RosClient, RosClient]
) -> None:
    (robot, _, operator), instance = sides, running[0]
    instance.stop("link_operator")
    instance.instance.middleware_file.write_text(ros_domain.peers_profile([LOOPBACK]))
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
