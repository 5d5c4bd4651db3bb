"""Two robots in one ROS domain, each in a namespace of its own, and one ordinary client of both."""

from __future__ import annotations

import tempfile
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from harness.system import RosClient, System, running
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import FORWARD, HOME, ROBOT, SUCCESSFUL, Topic, ask, go
from valor.common.instance import Instance, Settings
from valor.common.poses import Pose
from valor.common.transforms import TransformBuffer, TransformError
from valor.moveit import package

NAMESPACES = ("escher1", "lab/escher2")
PATIENCE = 120.0  # [s]


def settings(system: System) -> Settings:
    """What the robot was started with."""
    return Instance(system.name, Path(system.environment["VALOR_HOME"])).settings()


@pytest.fixture(scope="module")
def robots() -> Iterator[list[System]]:
    """Both, the first with a recorder; slowly, for together they have one computer."""
    with ExitStack() as stack:
        home = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="valor-", ignore_cleanup_errors=True)))
        usual = ("--rtf", "0.4", "--namespace")
        made = [stack.enter_context(running("robot0", home, *usual, NAMESPACES[0]))]
        domain = ("--domain", str(settings(made[0]).ros_domain_id), "--no-bag")
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
    wait_until(lambda: len(nodes(node)) >= 2 * 2 + 1, PATIENCE, "both robots' nodes")
    assert {space for _, space in nodes(node)} == {f"/{each}" for each in NAMESPACES}
    names = {name for name, _ in (*node.get_topic_names_and_types(), *node.get_service_names_and_types())}
    everybodys = {"/tf", "/tf_static", "/rosout", "/parameter_events"}
    strangers = {name for name in names if not name.startswith(tuple(f"/{each}/" for each in NAMESPACES))}
    assert strangers <= everybodys
    first, second = (
        {name.removeprefix(f"/{each}") for name in names if name.startswith(f"/{each}/")} for each in NAMESPACES
    )
    recorder = {name for name in first ^ second if "bag_recorder" in name}
    assert {name for name in first ^ second if "test_client" not in name} <= recorder


def heard_on(client: RosClient, kind: type, name: str) -> Any:
    """A message of a topic in the client's namespace."""
    topic = Topic(client, kind, name)
    wait_until(lambda: topic.messages, PATIENCE, f"{name} in {client.node.get_namespace()}")
    topic.close()
    return topic.messages[-1]


def keep(queue: deque[Any]) -> Callable[[Any], None]:
    """What puts messages there; rclpy asks callbacks for signatures, which built-in methods have not."""

    def take(message: Any) -> None:
        queue.append(message)

    return take


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
    from nav_msgs.msg import Odometry
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from tf2_msgs.msg import TFMessage

    buffer, ros = TransformBuffer(), clients[0]
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    moving, fixed = deque[Any](maxlen=1000), deque[Any]()
    heard = [
        ros.node.create_subscription(TFMessage, "/tf", keep(moving), 100),
        ros.node.create_subscription(TFMessage, "/tf_static", keep(fixed), latched),
    ]

    def whole() -> bool:
        for queue in (fixed, moving):
            while queue:
                for each in queue.popleft().transforms:
                    t, r, stamp = each.transform.translation, each.transform.rotation, each.header.stamp
                    pose = Pose((t.x, t.y, t.z), (r.w, r.x, r.y, r.z))
                    time = stamp.sec * 10**9 + stamp.nanosec
                    buffer.add(each.header.frame_id, each.child_frame_id, time, pose, static=queue is fixed)
        try:
            # Each by its own time: no two robots' clocks are one.
            heights = [buffer.lookup("map", f"{each}/base_link").position[2] for each in NAMESPACES]
            hands = [buffer.lookup("map", f"{each}/l_gripper").position[2] for each in NAMESPACES]
        except TransformError:
            return False
        return all(0.3 < height < 1.8 for height in (*heights, *hands))

    wait_until(whole, PATIENCE, "the frames of both robots under map")
    for subscription in heard:
        ros.destroy(ros.node.destroy_subscription, subscription)
    for client, namespace in zip(clients, NAMESPACES, strict=True):
        message = heard_on(client, Odometry, "odom")
        assert (message.header.frame_id, message.child_frame_id) == (f"{namespace}/odom", f"{namespace}/base_link")


def test_moveits_configuration_for_a_namespace_fits_the_robot_in_it(clients: list[RosClient], tmp_path: Path) -> None:
    """Its frames are tf's, and its controllers' actions are where a node in the namespace looks for them."""
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from tf2_msgs.msg import TFMessage

    client, name = clients[1], NAMESPACES[1]
    (folder := tmp_path / "mine").mkdir()
    package.write(ROBOT, folder, lambda _: None, 10, namespace=name)
    config = folder / "config"
    (place,) = ElementTree.parse(config / "escher.srdf").findall("virtual_joint")
    links = {each.get("name", "") for each in ElementTree.parse(config / "escher.urdf").findall("link")}
    wanted = {each for each in links if not each.endswith("_hinge")} | {place.get("parent_frame", "")}
    heard = deque[Any]()
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    listening = [
        client.node.create_subscription(TFMessage, "/tf", keep(heard), 100),
        client.node.create_subscription(TFMessage, "/tf_static", keep(heard), latched),
    ]

    def frames() -> set[str]:
        return {
            frame for each in list(heard) for t in each.transforms for frame in (t.header.frame_id, t.child_frame_id)
        }

    wait_until(lambda: wanted <= frames(), PATIENCE, "the frames of the configuration")
    for subscription in listening:
        client.destroy(client.node.destroy_subscription, subscription)
    assert f"{name}/base_link" in wanted and all(each.startswith(f"{name}/") for each in wanted)
    manager = yaml.safe_load((config / "moveit_controllers.yaml").read_text())["moveit_simple_controller_manager"]
    actions = {each: f"{each}/{manager[each]['action_ns']}" for each in manager["controller_names"]}
    servers = {each: ActionClient(client.node, FollowJointTrajectory, action) for each, action in actions.items()}
    for each, server in servers.items():
        assert server.wait_for_server(PATIENCE), actions[each]
        client._call(server.destroy)


def test_verbs_plans_diagnostics_and_parameters_are_of_the_robot_that_is_meant(
    robots: list[System], clients: list[RosClient]
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from rcl_interfaces.srv import GetParameters

    mover, other = clients
    go(other, "stand")
    still = other.joint_positions()
    for verb in (["mode", "stand_manipulate"], ["arm", "right", "home"]):
        robots[0].valorctl(*verb)
    now = other.joint_positions()
    assert max(abs(mover.joint_positions()[name] - HOME[name]) for name in HOME) < 0.05
    assert max(abs(now[name] - still[name]) for name in still) < 0.03
    for client, namespace in zip(clients, NAMESPACES, strict=True):
        message = heard_on(client, DiagnosticArray, "diagnostics")
        assert {status.hardware_id for status in message.status} == {namespace}
        names = ["frame_prefix", "publish_map"]
        prefix, with_map = ask(client, GetParameters, "valor_ros_controller/get_parameters", names=names).values
        assert prefix.string_value == f"{namespace}/" and with_map.bool_value


def test_a_third_that_would_be_in_the_way_is_refused_in_a_line(robots: list[System]) -> None:
    third = System("robot2", Path(robots[0].environment["VALOR_HOME"]))
    domain = str(settings(robots[0]).ros_domain_id)
    for options, words in (
        (("--domain", domain, "--namespace", NAMESPACES[0]), "has instance 'robot0' with namespace 'escher1', too"),
        (("--namespace", "2nd"), "namespace '2nd': expected letters"),
        (("--namespace", "bifrost"), "and not 'bifrost' first"),
        (("--peers", "no such host"), "expected a computer's name or IPv4 address"),
        (("--peers", "127.0.0.1"), "is this computer"),
    ):
        told = third.valorctl("up", "--no-bag", *options, expect=1)
        assert words in told.stderr and len(told.stderr.splitlines()) == 1, told.stderr
        assert "not up" in third.valorctl("status", expect=1).stderr


def test_a_bag_has_one_robots_topics_and_what_is_everybodys(robots: list[System]) -> None:
    from mcap.reader import make_reader

    robots[0].valorctl("down")
    (bag,) = Path(robots[0].environment["VALOR_HOME"], robots[0].name, "bags").rglob("*.mcap")
    with open(bag, "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    names = {channel.topic for channel in summary.channels.values()}
    assert {"/escher1/joint_states", "/escher1/diagnostics", "/tf", "/tf_static"} <= names
    assert "/bifrost/comms_manager/proprioceptor" in names
    assert not any(name.startswith("/lab/") for name in names)
