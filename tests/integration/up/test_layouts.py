"""What the layouts for Foxglove, PlotJuggler and RViz name is there: topics, fields of their messages, frames."""

import json
import re
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import yaml
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.up.viewer import Viewer
from valor.common.resources import example_file
from valor.ros.definitions import message_type

PLAIN = re.compile(r"boolean|double|float|string|u?int\d+|octet")
SCENE = "/valor/scene"


def foxgloves(content: dict[str, Any]) -> Iterator[str]:
    """Topics and fields that Foxglove's layout names."""
    for part in content.get("items", content.get("tabs", [])):
        yield from foxgloves(part["content"])
    settings = content.get("config", {})
    yield from settings.get("topics", {})
    image = settings.get("imageMode", {})
    yield from (image[key] for key in ("imageTopic", "calibrationTopic") if key in image)
    yield from (path["value"] for path in settings.get("paths", []))
    yield from (settings[key] for key in ("topicPath", "topicToRender") if key in settings)


def plotjugglers() -> Iterator[str]:
    """Likewise of PlotJuggler's, whose curves have slashes throughout."""
    for curve in ElementTree.parse(example_file("layouts/plotjuggler.xml")).iter("curve"):
        names = [curve.attrib[key] for key in ("curve_x", "curve_y") if key in curve.attrib]
        yield from names or [curve.attrib["name"]]


def topic_of(path: str, types: dict[str, str]) -> str | None:
    """The topic that a path begins with; None: there is no such topic."""
    return max((name for name in types if re.match(rf"{re.escape(name)}([./]|$)", path)), key=len, default=None)


def check(path: str, ros: RosClient) -> None:
    """A topic, once it is discovered, then fields behind dots or slashes, the last a plain value."""
    types: dict[str, str] = {}

    def found() -> str | None:
        types.update({name: types[0] for name, types in ros.node.get_topic_names_and_types()})
        return topic_of(path, types)

    topic = wait_until(found, 20.0, f"{path}: a topic like that")
    assert topic is not None
    names = [each for each in re.split(r"[./]", path.removeprefix(topic)) if each]
    kind = types[topic]
    for name in names:
        message: Any = message_type(kind.replace("/", "/msg/") if kind.count("/") == 1 else kind)
        known = message.get_fields_and_field_types()
        assert name in known, f"{path}: {kind} has no {name}"
        kind = known[name]
    assert not names or PLAIN.fullmatch(kind), f"{path}: {kind} is no value to plot"


def test_topics_and_fields_of_foxgloves_are_there(ros: RosClient, viewer: Viewer) -> None:
    layout = json.loads(example_file("layouts/foxglove.json").read_text())
    paths = set(foxgloves(layout["content"]))
    assert SCENE in paths and len(paths) >= 15
    viewer.wait(lambda: SCENE in viewer.channels, "the scene is offered")
    for path in sorted(paths - {SCENE}):
        check(path, ros)


def test_topics_and_fields_of_plotjugglers_are_there(ros: RosClient) -> None:
    paths = list(plotjugglers())
    assert len(paths) >= 10
    for path in paths:
        check(path, ros)


def test_topics_types_and_frames_of_rvizs_are_there(ros: RosClient) -> None:
    shown = {
        "RobotModel": "std_msgs/msg/String", "Wrench": "geometry_msgs/msg/WrenchStamped",
        "PointStamped": "geometry_msgs/msg/PointStamped", "Odometry": "nav_msgs/msg/Odometry",
        "PointCloud2": "sensor_msgs/msg/PointCloud2", "LaserScan": "sensor_msgs/msg/LaserScan",
        "Image": "sensor_msgs/msg/Image",
    }  # fmt: skip
    manager = yaml.safe_load(example_file("layouts/valor.rviz").read_text())["Visualization Manager"]
    for display in manager["Displays"]:
        topic = display.get("Topic") or display.get("Description Topic")
        if topic is not None:
            check(topic["Value"], ros)
            types = dict(ros.node.get_topic_names_and_types())
            assert types[topic["Value"]] == [shown[display["Class"].split("/")[1]]], display["Name"]
    layout = json.loads(example_file("layouts/foxglove.json").read_text())
    three = layout["content"]["items"][0]["content"]["config"]
    named = {manager["Global Options"]["Fixed Frame"], manager["Views"]["Current"]["Target Frame"]}
    named |= {three["fixedFrame"], three["followTf"]}
    frames: set[str] = set()

    def hear(message: TFMessage) -> None:
        frames.update(name for each in message.transforms for name in (each.header.frame_id, each.child_frame_id))

    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    ros._call(ros.node.create_subscription, TFMessage, "/tf", hear, 10)
    ros._call(ros.node.create_subscription, TFMessage, "/tf_static", hear, latched)
    wait_until(lambda: named <= frames, 20.0, f"frames {', '.join(sorted(named))}")
