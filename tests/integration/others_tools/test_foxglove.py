"""Foxglove live: what a client of its protocol sees of a running robot, and that it can only look."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree

import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from vigir_humanoid_control_msgs.msg import ControlModeStatus

from harness.places import ROBOTS
from harness.system import RosClient, System
from harness.waiting import wait_until
from tests.integration.others_tools.viewer import Viewer, entities, schema_mentions
from valor.common.processes import BY_NAME, FOXGLOVE
from valor.robot.description import RobotDescription
from valor.robot.model import controller_model
from valor.ros.topics import shown

SCENE = "/valor/scene"
GRAVITY = 9.81


def subscriptions(ros: RosClient) -> set[str]:
    """Topics that the bridge hears."""
    wait_until(lambda: FOXGLOVE in ros.node.get_node_names(), 20.0, "the bridge's node is known")
    return {name for name, _ in ros.node.get_subscriber_names_and_types_by_node(FOXGLOVE, "/")}


def service(system: System) -> dict[str, Any]:
    return next(each for each in system.status()["services"] if each["name"] == FOXGLOVE)


def test_every_topic_of_the_graph_is_offered_with_its_type(viewer: Viewer, ros: RosClient) -> None:
    assert viewer.info["capabilities"] == ["assets"]
    own = f"/{ros.node.get_name()}/"

    def known() -> dict[str, str]:
        return {
            name: types[0]
            for name, types in ros.node.get_topic_names_and_types()
            if shown(name) and not name.startswith(own) and ros.node.count_publishers(name)
        }

    needed = {"/joint_states", "/tf", "/flor/controller/mode", "/diagnostics", "/robot_description"}
    wait_until(lambda: needed <= known().keys(), 20.0, "the graph is known")
    told = known()
    viewer.wait(lambda: set(told) < set(viewer.channels), "all are offered")
    for name, type_name in told.items():
        channel = viewer.channels[name]
        assert (channel["schemaName"], channel["schemaEncoding"], channel["encoding"]) == (type_name, "ros2msg", "cdr")
    assert viewer.channels[SCENE]["schemaName"] == "foxglove.SceneUpdate"
    assert schema_mentions(viewer.channels[SCENE], "ArrowPrimitive")


def test_joint_states_are_those_that_ros_has_and_decode_by_their_schema_alone(viewer: Viewer, ros: RosClient) -> None:
    states: list[JointState] = []
    ros._call(ros.node.create_subscription, JointState, "/joint_states", states.append, 100)
    viewer.subscribe("/joint_states")
    viewer.wait(lambda: len(viewer.heard["/joint_states"]) >= 250 and len(states) >= 250, "a second of joint states")
    stamps = [stamp for stamp, _ in viewer.heard["/joint_states"]]
    assert stamps == sorted(stamps)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(viewer.channels["/joint_states"]["schema"], "sensor_msgs/msg/JointState"))
    by_stamp = {(state.header.stamp.sec, state.header.stamp.nanosec): state for state in states}
    compared = 0
    for _, data in viewer.heard["/joint_states"]:
        seen = store.deserialize_cdr(data, "sensor_msgs/msg/JointState")
        same = by_stamp.get((seen.header.stamp.sec, seen.header.stamp.nanosec))
        if same is not None:
            assert list(seen.name) == list(same.name) and seen.position.tolist() == list(same.position)
            assert seen.velocity.tolist() == list(same.velocity) and seen.effort.tolist() == list(same.effort)
            compared += 1
    assert compared >= 50


def test_who_comes_late_is_told_what_is_latched(viewer: Viewer, port: int) -> None:
    latched = ("/robot_description", "/tf_static", "/flor/controller/mode")
    viewer.subscribe(*latched)
    viewer.wait(lambda: all(viewer.heard[topic] for topic in latched), "the first is told")
    with Viewer(port) as late:
        late.subscribe(*latched, "/tf")
        late.wait(lambda: all(late.heard[topic] for topic in latched) and late.heard["/tf"], "the second, too")
        heard = {topic: data[-1][1] for topic, data in late.heard.items()}
    urdf = ElementTree.fromstring(deserialize_message(heard["/robot_description"], String).data)
    frames = {
        each.child_frame_id
        for topic in ("/tf", "/tf_static")
        for each in deserialize_message(heard[topic], TFMessage).transforms
    }
    links = {link.attrib["name"] for link in urdf.iter("link")}
    assert {"base_link", "l_sole", "r_sole"} <= links & frames
    assert [link for link in urdf.iter("link") if link.find("visual") is not None]
    mode = deserialize_message(heard["/flor/controller/mode"], ControlModeStatus)
    assert mode.current_control_mode == "stand"


def test_meshes_of_the_description_can_be_fetched_and_no_other_file(viewer: Viewer, tmp_path: Path) -> None:
    secret = tmp_path / "secret.stl"
    secret.write_text("solid")
    viewer.subscribe("/robot_description")
    viewer.wait(lambda: viewer.heard["/robot_description"], "the description")
    urdf = ElementTree.fromstring(deserialize_message(viewer.heard["/robot_description"][0][1], String).data)
    named = sorted({mesh.attrib["filename"] for mesh in urdf.iter("mesh")})
    for uri in named:
        assert viewer.fetch(uri) == Path(unquote(urlsplit(uri).path)).read_bytes()
    for uri in (secret.as_uri(), "file:///etc/hostname", "package://valor/robot.yaml"):
        assert viewer.fetch(uri) is None


def test_the_scene_has_soles_forces_balance_and_the_world(viewer: Viewer) -> None:
    viewer.subscribe(SCENE)
    found: dict[str, Any] = {}

    def all_there() -> bool:
        while viewer.heard[SCENE]:
            found.update({each.id: each for each in entities(viewer.heard[SCENE].pop(0)[1])})
        return {"world", "l_foot", "r_foot", "com", "dcm", "dcm_reference", "cop"} <= set(found)

    viewer.wait(all_there, "all entities")
    robot = RobotDescription.load(ROBOTS / "escher")
    weight = GRAVITY * float(controller_model(robot).mj.body_mass.sum())
    assert (found["l_foot"].frame, found["r_foot"].frame) == ("l_sole", "r_sole")
    assert all(len(found[name].parts["lines"]) == 1 for name in ("l_foot", "r_foot"))
    arrows = [shaft for name in ("l_foot", "r_foot") for shaft in found[name].shafts()]
    assert sum(arrows) * 1e3 == pytest.approx(weight, rel=0.1), "arrows of a metre a kilonewton carry the robot"
    assert found["com"].frame == found["world"].frame == "odom"
    assert len(found["world"].parts["cubes"]) >= 6  # floor and stairs


def test_nothing_is_heard_while_nobody_looks(viewer: Viewer, ros: RosClient, system: System) -> None:
    wait_until(lambda: not subscriptions(ros), 20.0, "those of before are gone")
    viewer.subscribe("/odom", SCENE)
    viewer.wait(lambda: viewer.heard["/odom"] and viewer.heard[SCENE], "both come")
    wait_until(lambda: {"/odom", "/flor/state/com"} <= subscriptions(ros), 20.0, "both are heard")
    assert "/joint_states" not in subscriptions(ros)
    wait_until(lambda: service(system)["detail"].endswith(": 1 looking"), 20.0, "status says who looks")
    viewer.unsubscribe("/odom", SCENE)
    wait_until(lambda: not subscriptions(ros), 20.0, "nothing is heard any more")
    told = service(system)
    assert told["state"] == "ready" and told["memory_mib"] < BY_NAME[FOXGLOVE].memory_budget


def test_whoever_looks_can_only_look(viewer: Viewer, ros: RosClient, tmp_path: Path) -> None:
    data = serialize_message(String(data="stand_manipulate"))
    topic = "/flor/controller/mode_command"
    wished = {"id": 1, "topic": topic, "encoding": "cdr", "schemaName": "std_msgs/msg/String"}
    viewer.say(op="advertise", channels=[wished])
    viewer.send(b"\x01" + struct.pack("<I", 1) + data)
    viewer.wait(lambda: viewer.told["status"], "he is told that he cannot")
    publishers = [each.node_name for each in ros.node.get_publishers_info_by_topic(topic)]
    assert FOXGLOVE not in publishers
    viewer.subscribe("/flor/controller/mode")
    viewer.wait(lambda: viewer.heard["/flor/controller/mode"], "the mode")
    mode = deserialize_message(viewer.heard["/flor/controller/mode"][-1][1], ControlModeStatus)
    assert mode.current_control_mode == "stand"


def test_what_is_looked_at_goes_on_when_the_controller_and_the_bridge_begin_anew(
    viewer: Viewer, system: System, port: int
) -> None:
    viewer.subscribe("/joint_states")
    viewer.wait(lambda: viewer.heard["/joint_states"], "joint states")
    system.valorctl("restart", "valor_ros_controller")
    before = len(viewer.heard["/joint_states"])
    viewer.wait(lambda: len(viewer.heard["/joint_states"]) > before + 250, "they go on")
    system.valorctl("restart", FOXGLOVE)
    with Viewer(port) as again:
        again.subscribe("/joint_states")
        again.wait(lambda: len(again.heard["/joint_states"]) > 50, "the address is as before")
