"""``map`` → ``odom`` is the identity until a localiser publishes another, by real nodes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import TransformStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

from valor.common.resources import middleware_profile
from valor.ros.parameters import Parameters
from valor.valor_ros_controller.ros.static_transforms import TF, TF_STATIC, StaticTransforms

PATIENCE = 60.0  # [s]
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ODOM, BASE = "escher1/odom", "escher1/base_link"


def transform(parent: str, child: str) -> TransformStamped:
    made = TransformStamped(child_frame_id=child)
    made.header.frame_id = parent
    return made


class Graph:
    """Nodes of one executor: the robot's, and others made on demand."""

    def __init__(self, domain: int) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.nodes: list[Any] = []
        self.robot = self.node("valor_ros_controller", "escher1")

    def node(self, name: str, namespace: str | None = None) -> Any:
        made = rclpy.create_node(name, context=self.context, namespace=namespace, enable_rosout=False)
        self.nodes.append(made)
        self.executor.add_node(made)
        return made

    def wait(self, condition: Callable[[], Any], meanwhile: Callable[[], object] = lambda: None) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end
            meanwhile()
            self.executor.spin_once(timeout_sec=0.02)

    def told(self) -> list[tuple[str, str]]:
        """What /tf_static tells somebody who joins now."""
        heard: list[Any] = []
        node = self.node(f"listener{len(self.nodes)}")
        node.create_subscription(TFMessage, TF_STATIC, heard.append, LATCHED)
        self.wait(lambda: any(t.child_frame_id == BASE for message in heard for t in message.transforms))
        robots = next(message for message in heard if any(t.child_frame_id == BASE for t in message.transforms))
        return [(t.header.frame_id, t.child_frame_id) for t in robots.transforms]

    def close(self) -> None:
        self.executor.shutdown()
        for node in self.nodes:
            node.destroy_node()
        self.context.shutdown()


@pytest.fixture
def graph(ros_domain: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Graph]:
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(middleware_profile()))
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    made = Graph(ros_domain)
    yield made
    made.close()


OWN = ("escher1/pelvis", BASE)  # any of the robot's own


def start(graph: Graph) -> StaticTransforms:
    return StaticTransforms(graph.robot, Parameters(graph.robot), [transform(*OWN)], ODOM, BASE)


@pytest.mark.parametrize("topic", [TF, TF_STATIC])
def test_a_localiser_takes_over_and_the_parameter_brings_the_identity_back(graph: Graph, topic: str) -> None:
    static = start(graph)
    own = graph.robot.create_publisher(TFMessage, TF, 100)
    assert graph.told() == [OWN, ("map", ODOM)]

    camera = graph.node("camera")
    cameras = camera.create_publisher(TFMessage, TF, 10)
    both = TFMessage(transforms=[transform(ODOM, BASE), transform(ODOM, "escher1/base_footprint")])

    def others() -> None:
        own.publish(both)
        cameras.publish(TFMessage(transforms=[transform(BASE, "camera"), transform("map", "escher2/odom")]))

    graph.wait(lambda: static._heard, others)
    for _ in range(200):
        others()
        graph.executor.spin_once(timeout_sec=0.0)
    static._look()
    assert graph.told() == [OWN, ("map", ODOM)], "who moves something else takes nothing over"

    localiser = graph.node("localiser").create_publisher(TFMessage, topic, LATCHED if topic == TF_STATIC else 10)
    graph.wait(
        lambda: not static._with_map, lambda: localiser.publish(TFMessage(transforms=[transform("world", ODOM)]))
    )
    assert graph.told() == [OWN] and not static._heard

    graph.robot.set_parameters([Parameter("publish_map", value=False), Parameter("publish_map", value=True)])
    assert ("map", ODOM) in graph.told()


def test_without_map_there_is_none_and_nobody_listens(graph: Graph) -> None:
    graph.robot.destroy_node()
    graph.nodes.remove(graph.robot)
    overrides = [Parameter("publish_map", value=False)]
    graph.robot = rclpy.create_node(
        "valor_ros_controller", context=graph.context, namespace="escher1", parameter_overrides=overrides
    )
    graph.nodes.append(graph.robot)
    graph.executor.add_node(graph.robot)
    static = start(graph)
    other = graph.node("other").create_publisher(TFMessage, TF, 10)
    graph.wait(lambda: graph.robot.count_publishers(TF), lambda: other.publish(TFMessage()))
    static._look()
    assert graph.told() == [OWN] and not static._heard
