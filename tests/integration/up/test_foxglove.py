"""Foxglove live: what a client of its protocol sees of a running robot, and that it can only look."""

import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree

from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from vigir_humanoid_control_msgs.msg import ControlModeStatus

from harness.system import RosClient, System
from harness.waiting import wait_until
from tests.integration.up.viewer import Viewer, schema_mentions
from valor.common.processes import BY_NAME, FOXGLOVE
from valor.ros.topics import shown

SCENE = "/valor/scene"


def subscriptions(ros: RosClient) -> set[str]:
    """Topics that the bridge receives."""
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
    reported = known()
    viewer.wait(lambda: set(reported) < set(viewer.channels), "all are offered")
    for name, type_name in reported.items():
        channel = viewer.channels[name]
        assert (channel["schemaName"], channel["schemaEncoding"], channel["encoding"]) == (type_name, "ros2msg", "cdr")
    assert viewer.channels[SCENE]["schemaName"] == "foxglove.SceneUpdate"
    assert schema_mentions(viewer.channels[SCENE], "ArrowPrimitive")


def test_joint_states_decode_by_their_schema_alone_and_are_those_of_ros(viewer: Viewer, ros: RosClient) -> None:
    states: list[JointState] = []
    ros._call(ros.node.create_subscription, JointState, "/joint_states", states.append, 100)
    viewer.subscribe("/joint_states")
    viewer.wait(lambda: len(viewer.heard["/joint_states"]) >= 250 and len(states) >= 250, "a second of joint states")
    stamps = [stamp for stamp, _ in viewer.heard["/joint_states"]]
    assert stamps == sorted(stamps)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(viewer.channels["/joint_states"]["schema"], "sensor_msgs/msg/JointState"))
    positions = {tuple(state.position) for state in states}
    seen = [store.deserialize_cdr(data, "sensor_msgs/msg/JointState") for _, data in viewer.heard["/joint_states"]]
    assert sum(tuple(state.position.tolist()) in positions for state in seen) >= 50


def test_who_comes_late_is_reported_what_is_latched(viewer: Viewer, port: int) -> None:
    latched = ("/robot_description", "/tf_static", "/flor/controller/mode")
    viewer.subscribe(*latched)
    viewer.wait(lambda: all(viewer.heard[topic] for topic in latched), "the first is told")
    with Viewer(port) as late:
        late.subscribe(*latched, "/tf")

        def frames() -> set[str]:
            """Child frames of all publishers' transforms: each sensor publishes that of its mount."""
            messages = [data for topic in ("/tf", "/tf_static") for _, data in late.heard[topic]]
            transforms = [each for data in messages for each in deserialize_message(data, TFMessage).transforms]
            return {each.child_frame_id for each in transforms}

        late.wait(lambda: all(late.heard[topic] for topic in latched), "latched messages at the second viewer")
        received = {topic: data[-1][1] for topic, data in late.heard.items()}
        urdf = ElementTree.fromstring(deserialize_message(received["/robot_description"], String).data)
        links = {link.attrib["name"] for link in urdf.iter("link")}
        late.wait(lambda: {"base_link", "l_sole", "r_sole"} <= links & frames(), "transforms of base and soles")
    assert [link for link in urdf.iter("link") if link.find("visual") is not None]
    mode = deserialize_message(received["/flor/controller/mode"], ControlModeStatus)
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
    wanted = ["world", "l_foot", "r_foot", "com", "dcm", "dcm_reference", "cop", "l_sole", "r_sole", "odom"]

    def scene() -> bytes:
        return b"".join(data for _, data in viewer.heard[SCENE])

    viewer.wait(lambda: all(name.encode() in scene() for name in wanted), "all entities and their frames")


def test_nothing_is_received_while_nobody_looks(viewer: Viewer, ros: RosClient, system: System) -> None:
    wait_until(lambda: not subscriptions(ros), 20.0, "those of before are gone")
    viewer.subscribe("/odom", SCENE)
    viewer.wait(lambda: viewer.heard["/odom"] and viewer.heard[SCENE], "both come")
    wait_until(lambda: {"/odom", "/flor/state/com"} <= subscriptions(ros), 20.0, "both are heard")
    assert "/joint_states" not in subscriptions(ros)
    wait_until(lambda: service(system)["detail"].endswith(": 1 looking"), 20.0, "status says who looks")
    viewer.unsubscribe("/odom", SCENE)
    wait_until(lambda: not subscriptions(ros), 20.0, "nothing is heard any more")
    reported = service(system)
    assert reported["state"] == "ready" and reported["memory_mib"] < BY_NAME[FOXGLOVE].memory_budget


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
