"""Two robots in one ROS domain, each in a namespace of its own, and one ordinary client of both."""

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import GetParameters
from tf2_msgs.msg import TFMessage

from harness.system import RosClient, System, running
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import FORWARD, HOME, SUCCESSFUL, Topic, ask, go
from valor.common.instance import Instance, Settings
from valor.common.poses import Pose
from valor.common.transforms import TransformBuffer, TransformError

NAMESPACES = ("escher1", "lab/escher2")
PATIENCE = 120.0  # [s]


def settings(system: System) -> Settings:
    return Instance(system.name, Path(system.environment["VALOR_HOME"])).settings()


@pytest.fixture(scope="module")
def robots() -> Iterator[list[System]]:
    """Both, slowly: they share one computer."""
    with ExitStack() as stack:
        home = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="valor-", ignore_cleanup_errors=True)))
        usual = ("--rtf", "0.4", "--no-bag", "--namespace")
        made = [stack.enter_context(running("robot0", home, *usual, NAMESPACES[0]))]
        domain = ("--domain", str(settings(made[0]).ros_domain_id))
        made.append(stack.enter_context(running("robot1", home, *usual, NAMESPACES[1], *domain)))
        yield made


@pytest.fixture(scope="module")
def clients(robots: list[System]) -> Iterator[list[RosClient]]:
    """One process' node for each robot, in the robot's namespace; both robots stand."""
    made = [RosClient(each.join(), namespace=settings(each).namespace) for each in robots]
    for client in made:
        go(client, "stand")
    yield made
    for client in made:
        client.close()


def test_every_name_is_in_one_namespace_or_everybodys(clients: list[RosClient]) -> None:
    node = clients[0].node
    wait_until(lambda: len(nodes(node)) >= 2 * 2, PATIENCE, "both robots' nodes")
    assert {space for _, space in nodes(node)} == {f"/{each}" for each in NAMESPACES}
    everybodys = {"/tf", "/tf_static", "/rosout", "/parameter_events"}

    def names() -> set[str]:
        return {name for name, _ in (*node.get_topic_names_and_types(), *node.get_service_names_and_types())}

    def strangers() -> set[str]:
        return {name for name in names() if not name.startswith(tuple(f"/{each}/" for each in NAMESPACES))}

    # Names of a killed participant last until its lease ends, also those of an earlier system in this ROS domain.
    wait_until(lambda: strangers() <= everybodys, PATIENCE, "names in the robots' namespaces alone")
    first, second = (
        {name.removeprefix(f"/{each}") for name in names() if name.startswith(f"/{each}/")} for each in NAMESPACES
    )
    assert not {name for name in first ^ second if "test_client" not in name}


def received_on(client: RosClient, kind: type, name: str) -> Any:
    topic = Topic(client, kind, name)
    wait_until(lambda: topic.messages, PATIENCE, f"{name} in {client.node.get_namespace()}")
    topic.close()
    return topic.messages[-1]


def nodes(node: Any) -> list[tuple[str, str]]:
    return [(name, space) for name, space in node.get_node_names_and_namespaces() if name != "test_client"]


def test_an_arm_goal_to_one_moves_only_that_one(clients: list[RosClient]) -> None:
    mover, other = clients
    go(mover, "stand_manipulate")
    still = other.joint_positions()
    answer = mover.follow("right_arm", [(2.5, FORWARD)], timeout=PATIENCE)
    assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
    moved, now = mover.joint_positions(), other.joint_positions()
    assert max(abs(moved[name] - FORWARD[name]) for name in FORWARD) < 0.05
    assert max(abs(moved[name] - still[name]) for name in FORWARD) > 0.3
    assert max(abs(now[name] - still[name]) for name in still) < 0.03
    assert other.reports[-1].current_control_mode == "stand"


def test_tf_is_one_tree_of_both(clients: list[RosClient]) -> None:
    buffer, ros = TransformBuffer(), clients[0]
    moving, fixed = Topic(ros, TFMessage, "/tf"), Topic(ros, TFMessage, "/tf_static", latched=True)

    def whole() -> bool:
        for topic in (fixed, moving):
            while topic.messages:
                for each in topic.messages.pop(0).transforms:
                    t, r, stamp = each.transform.translation, each.transform.rotation, each.header.stamp
                    pose = Pose((t.x, t.y, t.z), (r.w, r.x, r.y, r.z))
                    time = stamp.sec * 10**9 + stamp.nanosec
                    buffer.add(each.header.frame_id, each.child_frame_id, time, pose, static=topic is fixed)
        try:
            # Each by its own time: no two robots' clocks are one.
            heights = [buffer.lookup("map", f"{each}/base_link").position[2] for each in NAMESPACES]
            hands = [buffer.lookup("map", f"{each}/l_gripper").position[2] for each in NAMESPACES]
        except TransformError:
            return False
        return all(0.3 < height < 1.8 for height in (*heights, *hands))

    wait_until(whole, PATIENCE, "the frames of both robots under map")
    for topic in (fixed, moving):
        topic.close()
    for client, namespace in zip(clients, NAMESPACES, strict=True):
        message = received_on(client, Odometry, "odom")
        assert (message.header.frame_id, message.child_frame_id) == (f"{namespace}/odom", f"{namespace}/base_link")


def test_verbs_plans_and_parameters_are_of_the_robot_that_is_meant(
    robots: list[System], clients: list[RosClient]
) -> None:
    mover, other = clients
    go(other, "stand")
    still = other.joint_positions()
    for verb in (["mode", "stand_manipulate"], ["arm", "right", "home"]):
        robots[0].valorctl(*verb)
    now = other.joint_positions()
    assert max(abs(mover.joint_positions()[name] - HOME[name]) for name in HOME) < 0.05
    assert max(abs(now[name] - still[name]) for name in still) < 0.03
    for client, namespace in zip(clients, NAMESPACES, strict=True):
        message = received_on(client, DiagnosticArray, "diagnostics")
        assert {status.hardware_id for status in message.status} == {namespace}
        names = ["frame_prefix", "publish_map"]
        prefix, with_map = ask(client, GetParameters, "valor_ros_controller/get_parameters", names=names).values
        assert prefix.string_value == f"{namespace}/" and with_map.bool_value
