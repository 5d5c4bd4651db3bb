"""A ROS node beside the recorder."""

from collections.abc import Iterator

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from harness.instance import RunningInstance


@pytest.fixture
def ros(instance: RunningInstance, monkeypatch: pytest.MonkeyPatch) -> Iterator[Node]:
    for name, value in instance.instance.environment().items():
        monkeypatch.setenv(name, value)
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node("test", context=context)
    yield node
    node.destroy_node()
    context.shutdown()
