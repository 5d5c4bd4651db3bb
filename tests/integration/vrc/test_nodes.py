"""What a ROS 2 user sees of the nodes themselves: time, life, log, parameters; started by a launch file's commands."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from lifecycle_msgs.msg import Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from rosbags.highlevel import AnyReader
from valor_msgs.msg import BalanceWeights
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import Step, StepPlan

import bifrost
from harness.instance import RunningInstance
from harness.places import REPOSITORY
from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import HOME, PATIENCE, VRC, Topic, ask, go, pass_robot_time
from valor.common.topics import PROPRIOCEPTOR

CONVERTER, RECORDER = "footstep_converter", "bag_recorder"
NODES = (VRC, CONVERTER)
WARN = 30
LAUNCH = REPOSITORY / "examples" / "ros_nodes.launch.xml"


@pytest.fixture(scope="module")
def rosout(ros: RosClient) -> Iterator[Topic]:
    made = Topic(ros, Log, "/rosout", latched=True)
    yield made
    made.close()


def said(rosout: Topic, node: str, *words: str, level: int = WARN) -> list[str]:
    """What a node has said at a level with all the words in it."""
    return [
        line.msg
        for line in list(rosout.messages)
        if line.name == node and line.level == level and all(word in line.msg for word in words)
    ]


def state(ros: RosClient, node: str) -> str:
    return str(ask(ros, GetState, f"/{node}/get_state").current_state.label)


def change(ros: RosClient, node: str, transition: str) -> bool:
    return bool(ask(ros, ChangeState, f"/{node}/change_state", transition=Transition(label=transition)).success)


def parameter(ros: RosClient, node: str, name: str) -> Any:
    return ask(ros, GetParameters, f"/{node}/get_parameters", names=[name]).values[0]


def subscribed(ros: RosClient, node: str) -> list[str]:
    """Topics to which a node subscribes."""
    return [name for name, _ in ros.node.get_subscriber_names_and_types_by_node(node, "/")]


def plan(ros: RosClient) -> Any:
    """The result of a plan that is wrong in any case."""
    client = ActionClient(ros.node, ExecuteStepPlan, "/robot_controllers/footstep_controller/execute_step_plan")
    goal = ExecuteStepPlan.Goal(step_plan=StepPlan(steps=[Step()]))
    try:
        return ros._run(client, goal, PATIENCE).result
    finally:
        ros.destroy(lambda each: each.destroy(), client)


@pytest.mark.parametrize("node", NODES)
def test_in_simulation_time_is_robot_time_for_every_node(ros: RosClient, node: str) -> None:
    assert parameter(ros, node, "use_sim_time").bool_value
    assert ros.node.count_publishers("/clock") == 1


@pytest.mark.parametrize("node", NODES)
def test_a_node_says_that_it_is_active_and_its_life_is_its_own(ros: RosClient, rosout: Topic, node: str) -> None:
    wait_until(lambda: state(ros, node) == "active", PATIENCE, f"{node} to be active")
    for transition in ("configure", "cleanup", "shutdown", "dance"):
        assert not change(ros, node, transition)
        wait_until(lambda t=transition: said(rosout, node, "change_state", t), PATIENCE, "why not")  # type: ignore[misc]
    assert state(ros, node) == "active"


def test_the_controller_cannot_be_paused_and_the_converter_can(ros: RosClient, rosout: Topic) -> None:
    events = Topic(ros, TransitionEvent, f"/{CONVERTER}/transition_event")
    wait_until(lambda: ros.node.count_publishers(f"/{CONVERTER}/transition_event"), PATIENCE, "its events")
    assert not change(ros, VRC, "deactivate") and state(ros, VRC) == "active"
    assert change(ros, CONVERTER, "deactivate") and state(ros, CONVERTER) == "inactive"
    refused = plan(ros)
    assert refused.status.status and wait_until(
        lambda: said(rosout, CONVERTER, "plan rejected", "paused"), PATIENCE, "the refusal on /rosout"
    )
    assert not change(ros, CONVERTER, "deactivate"), "it is paused already"
    assert change(ros, CONVERTER, "activate") and state(ros, CONVERTER) == "active"
    wait_until(lambda: len(events.messages) >= 4, PATIENCE, "the events")
    assert [event.goal_state.label for event in events.messages[:4]] == [
        "deactivating", "inactive", "activating", "active",
    ]  # fmt: skip
    events.close()


def test_every_refusal_is_on_rosout_under_its_nodes_name(manipulating: RosClient, rosout: Topic) -> None:
    ros = manipulating
    assert ros.follow("right_arm", [(1.0, {"nose": 1.0})]).result.error_code
    assert not ros.change_mode("no_such_mode").status & 1
    plan(ros)
    commands: list[tuple[str, Any]] = [
        ("/flor/l_hand/goal_pose", PoseStamped()),  # the VRC refuses it
        ("/flor/controller/balance_weights", BalanceWeights(names=["nonsense"], weights=[1.0])),  # the Motion System
    ]
    for topic, message in commands:
        publisher = ros.node.create_publisher(type(message), topic, 1)
        wait_until(publisher.get_subscription_count, PATIENCE, topic)
        publisher.publish(message)
        wait_until(lambda t=topic: said(rosout, VRC, t.rpartition("/")[2]), PATIENCE, topic)  # type: ignore[misc]
        ros.destroy(ros.node.destroy_publisher, publisher)
    for node, words in (
        (VRC, ("right_arm", "rejected", "nose")),
        (VRC, ("no_such_mode", "rejected")),
        (CONVERTER, ("plan rejected",)),
    ):
        wait_until(lambda n=node, w=words: said(rosout, n, *w), PATIENCE, f"{node}: {words}")  # type: ignore[misc]


def test_a_controller_that_stalls_holds_time_up_within_the_bound_and_is_named(
    system: RunningInstance, ros: RosClient, node: bifrost.Node
) -> None:
    assert system.settings.wait_for_vrc and system.settings.clock == "lockstep"
    go(ros, "stand")
    diagnostics = Topic(ros, DiagnosticArray, "/diagnostics")
    heard = PROPRIOCEPTOR.subscriber(node)

    def robot_time() -> int:
        received = heard.receive(1.0)
        return received.message.time if received else 0

    process = system.process(VRC)
    os.kill(process.pid, signal.SIGSTOP)
    try:
        began = wait_until(robot_time, PATIENCE, "robot time")
        assert began
        wait_until(lambda: robot_time() - began > 500_000_000, PATIENCE, "robot time to go on without the VRC")
    finally:
        os.kill(process.pid, signal.SIGCONT)

    def named(name: str, *words: str) -> bool:
        return any(
            status.name == name and all(word in status.message for word in words)
            for message in list(diagnostics.messages)
            for status in message.status
        )

    wait_until(lambda: named(f"valor: {VRC}", "late", "robot time"), PATIENCE, "the late VRC in /diagnostics")
    wait_until(lambda: "in lockstep with" in system.log("comms_manager").rpartition("not waited for")[2], PATIENCE,
               "it to be waited for again")  # fmt: skip
    assert f"{VRC} is not waited for: no cycle within" in system.log("comms_manager")
    heard.close()
    diagnostics.close()


# --- nodes by themselves ----------------------------------------------------------------------------------------------


def command(name: str, *more: str, **arguments: str) -> list[str]:
    """How the example launch file starts a node, its arguments filled in."""
    root = ElementTree.parse(LAUNCH).getroot()
    values = {each.get("name", ""): each.get("default", "") for each in root.iter("arg")}
    (found,) = (each.get("cmd", "") for each in root.iter("executable") if each.get("name") == name)
    for key, value in (values | {"python": sys.executable} | arguments).items():
        found = found.replace(f"$(var {key})", value)
    return [*shlex.split(found), *more]


@contextmanager
def alone(system: RunningInstance, words: list[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A process by itself, that knows of the instance nothing but its name and where instances are."""
    environment = {key: os.environ[key] for key in ("PATH", "HOME") if key in os.environ}
    environment |= {"VALOR_INSTANCE": system.instance.name, "VALOR_HOME": str(system.instance.folder.parent)}
    with open(log, "wb") as file:
        process = subprocess.Popen(words, env=environment, stdout=file, stderr=subprocess.STDOUT)
    try:
        yield process
        process.send_signal(signal.SIGINT)  # as launch does
        assert process.wait(PATIENCE) == 0, log.read_text()
    finally:
        process.kill()
        process.wait()


def listed(ros: RosClient) -> Callable[[str], bool]:
    return lambda name: (
        name in {f"{space.rstrip('/')}/{node}" for node, space in ros.node.get_node_names_and_namespaces()}
    )


def test_the_recorder_by_itself_takes_its_parameters_and_pauses(
    system: RunningInstance, ros: RosClient, rosout: Topic, tmp_path: Path
) -> None:
    bag = tmp_path / "alone"
    more = ("-p", "record.topics:=['/rosout', '/odom']", "-p", "storage.max_bagfile_duration:=600.0")
    with alone(system, command(RECORDER, *more, bag=str(bag)), tmp_path / "log") as process:
        wait_until(lambda: state(ros, RECORDER) == "active", PATIENCE, "the recorder to record")
        assert process.poll() is None
        wait_until(lambda: "/odom" in subscribed(ros, RECORDER), PATIENCE, "its subscription")
        assert not parameter(ros, RECORDER, "use_sim_time").bool_value, "bags are on the wall's clock"
        assert parameter(ros, RECORDER, "storage.max_bagfile_duration").double_value == 600.0
        pass_robot_time(ros, 1.0)
        assert change(ros, RECORDER, "deactivate") and state(ros, RECORDER) == "inactive"
        assert change(ros, RECORDER, "activate")
        wait_until(lambda: said(rosout, RECORDER, "by a client", level=20), PATIENCE, "its words on /rosout")
        pass_robot_time(ros, 0.5)
    (file,) = bag.glob("*.mcap")
    with AnyReader([bag] if (bag / "metadata.yaml").exists() else [file]) as reader:
        topics = {connection.topic for connection in reader.connections}
        assert topics == {"/rosout", "/odom"} and reader.message_count > 10


def test_the_controller_by_itself_leads_the_robot(system: RunningInstance, ros: RosClient, tmp_path: Path) -> None:
    system.stop(VRC)
    try:
        with alone(system, command(VRC, "-r", "/odom:=/lab/odom", update_rate="125.0"), tmp_path / "log"):
            wait_until(lambda: state(ros, VRC) == "active", PATIENCE, "the controller to be active")
            assert parameter(ros, VRC, "update_rate").double_value == 125.0
            wait_until(lambda: ros.node.count_publishers("/lab/odom"), PATIENCE, "the remapped topic")
            go(ros, "stand_manipulate")
            assert ros.follow("right_arm", [(2.0, HOME)]).result.error_code == 0
    finally:
        system.start(VRC)
    system.wait_ready(VRC, PATIENCE)
