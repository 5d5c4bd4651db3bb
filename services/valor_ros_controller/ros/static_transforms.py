"""``/tf_static``: what is fixed to the robot's links, and ``map`` where a localiser would sit (REP 105).

``map`` → ``odom`` is the identity for as long as nobody else says where ``odom`` is. When a localiser does, on ``/tf``
or ``/tf_static``, the identity is withdrawn: tf2's listeners drop it with the first transform of the localiser's, and
who joins later is not told of it. It does not come back by itself: the robot would jump.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from tf2_msgs.msg import TFMessage

from valor.ros.node import STEADY, Untouched
from valor.ros.parameters import Parameters
from valor.ros.taking import uncalled, waiting
from valor.valor_ros_controller.ros.node import LATCHED

MAP = "map"
"""Without a robot's prefix: several robots in one domain share it, so that tf has one tree."""
TF, TF_STATIC = "/tf", "/tf_static"
"""Absolute: tf is one for all robots, whose frames bear prefixes (tf2's broadcasters and listeners know no other)."""
PERIOD = 1.0  # between looks for a localiser [s]
DEPTH = 100  # of /tf between two looks: a localiser's transforms are among them, however many others there are

_log = logging.getLogger("tf")


class StaticTransforms:
    """Publishes them, in the ROS thread after the start."""

    def __init__(
        self, node: Node, parameters: Parameters, fixed: Sequence[TransformStamped], odom: str, base: str
    ) -> None:
        """Publish them.

        Args:
            node: the ROS node.
            parameters: of the node; ``publish_map`` is declared.
            fixed: the robot's own.
            odom: the frame under ``map``, as tf names it.
            base: a frame that each of the robot's own messages names.

        Raises:
            ConfigurationError: the parameter was set at start to what it cannot be.
        """
        self._node, self._fixed, self._odom = node, list(fixed), odom
        self._its, self._own = (struct.pack("<I", len(name) + 1) + name.encode() + b"\0" for name in (odom, base))
        self._group = Untouched()
        self._heard: list[Any] = []
        self._publisher = node.create_publisher(TFMessage, TF_STATIC, LATCHED)
        self._with_map = False
        text = f"the identity as {MAP} → odom, until a localiser publishes another"
        self._publish(parameters.declare("publish_map", True, text, on_change=self._publish))
        # By the wall: a robot whose time stands may yet be localised.
        node.create_timer(PERIOD, self._look, clock=STEADY)

    def _publish(self, with_map: bool) -> None:
        self._with_map = with_map
        transforms = list(self._fixed)
        if with_map:
            transforms.append(TransformStamped(child_frame_id=self._odom))
            transforms[-1].header.frame_id = MAP
        self._publisher.publish(TFMessage(transforms=transforms))

    def _look(self) -> None:
        """Listen to tf while others publish there, too, and the identity may have to go."""
        others = self._others() if self._with_map else []
        if others and not self._heard:
            best_effort = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
            latched = QoSProfile(depth=DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self._heard = [
                self._node.create_subscription(TFMessage, *topic, raw=True, callback_group=self._group)
                for topic in ((TF, uncalled, best_effort), (TF_STATIC, uncalled, latched))
            ]
        if self._heard and (parent := self._parent()):
            _log.info("%s → %s is published by %s: the identity is withdrawn", parent, self._odom, " or ".join(others))
            self._publish(False)
            others = []
        if self._heard and not others:
            for subscription in self._heard:
                self._node.destroy_subscription(subscription)
            self._heard = []

    def _others(self) -> list[str]:
        """Names of other nodes that publish transforms."""
        own = (self._node.get_namespace(), self._node.get_name())
        infos = [info for topic in (TF, TF_STATIC) for info in self._node.get_publishers_info_by_topic(topic)]
        return sorted({info.node_name for info in infos if (info.node_namespace, info.node_name) != own})

    def _parent(self) -> str:
        """In which frame somebody else says that odom is; empty: nobody."""
        for subscription in self._heard:
            for data in waiting(subscription):
                if self._its not in data or self._own in data:
                    continue
                for transform in deserialize_message(data, TFMessage).transforms:
                    if transform.child_frame_id == self._odom:
                        return str(transform.header.frame_id)
        return ""
