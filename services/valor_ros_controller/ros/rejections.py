"""``/flor/controller/rejection``: what nobody is answered otherwise, by the Motion Manager's word or the VRC's.

Latched: who joins late, or looks only once a command had no effect, finds the last ones.
"""

from __future__ import annotations

import logging

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from valor_msgs.msg import Rejection as RosRejection

import bifrost
from valor.common.messages import Rejection
from valor.common.topics import REJECTION
from valor.valor_ros_controller.refusals import BoundedLog, Refusals
from valor.valor_ros_controller.ros.twin_publisher import TwinPublisher

_log = logging.getLogger("rejections")

TOPIC = "flor/controller/rejection"
KEPT = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
QUEUE = 50  # of the Motion Manager's
AT_ONCE = 10  # of them


class Rejections:
    """Update thread.

    Attributes:
        heard: what it listens to.
        own: commands that are refused here, and not handed over.
        refusals: of anybody's commands, by the Motion Manager or by this.
        last: the newest of them: topic and reason.
    """

    def __init__(self, ros: Node, node: bifrost.Node) -> None:
        """Open the topic.

        Args:
            ros: the ROS node.
            node: to the Bifrost network.
        """
        self._origin, self._resolved = node.name, ros.resolve_topic_name
        self.heard = REJECTION.subscriber(node, queue=QUEUE)
        self._publisher = TwinPublisher(ros, RosRejection, TOPIC, KEPT)
        self._sources: list[tuple[str, Refusals]] = []
        self.own = Refusals(BoundedLog(_log), "{}")
        self._log = BoundedLog(_log)  # of the Motion System's: it has no other way to /rosout
        self.refusals = 0
        self.last = ""

    def tell_of(self, topic: str, refusals: Refusals) -> None:
        """Tell what is refused of requests that come on a topic."""
        self._sources.append((self._resolved(topic), refusals))

    def refuse(self, topic: str, reason: str) -> None:
        """Say that a command is not handed over."""
        topic = self._resolved(topic)
        self.own.add(topic, reason, answered=True)
        self._tell_own(topic, reason, self.own.count)

    def publish(self) -> None:
        """What is new."""
        for rejection in self.heard.drain(AT_ONCE):
            message = rejection.message
            self._log.warning(f"{message.topic} of {message.origin} refused: {message.reason}")
            self._tell(rejection)
        for topic, refusals in self._sources:
            for refusal in refusals.news():
                self._tell_own(topic, refusal.reason, refusal.count)

    def _tell_own(self, topic: str, reason: str, count: int) -> None:
        rejection = Rejection(topic=topic, origin=self._origin, reason=reason, count=count)
        self._tell(bifrost.Received(rejection, 0, count, self._origin))

    def _tell(self, rejection: bifrost.Received[Rejection]) -> None:
        self.refusals += 1
        self.last = f"{rejection.message.topic}: {rejection.message.reason}"
        self._publisher.publish(rejection)
