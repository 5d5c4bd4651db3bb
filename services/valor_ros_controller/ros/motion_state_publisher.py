"""What only the Motion System knows: its state, and for plots CoM, DCM, CoP, and what touches the world."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from std_msgs.msg import Bool
from valor_msgs.msg import MotionState as RosMotionState

from bifrost import Received
from valor.common.messages import MotionState
from valor.robot.tables import Hands
from valor.ros.limbs import FEET, HANDS
from valor.ros.transforms import ODOM
from valor.valor_ros_controller.ros.node import LATCHED
from valor.valor_ros_controller.ros.twin_publisher import TwinPublisher

RATE = 25.0  # of the points [Hz]
STATE_RATE = 10.0  # of the motion state [Hz]
POINTS = ("com", "dcm", "dcm_reference", "cop")
TOUCHING = FEET + HANDS


class MotionStatePublisher:
    """Update thread.

    ``/flor/state/<point>`` in odom; ``/flor/<limb>/contact`` on change, latched; ``/flor/controller/motion_state``,
    also when the behavior changes, latched.
    """

    def __init__(self, node: Node, hands: Hands, stamp: Time, rate: float, frame: str = ODOM) -> None:
        """Make publishers and messages.

        Args:
            node: the ROS node.
            hands: that the robot has; of others nothing is said.
            stamp: robot time, kept up to date by its owner.
            rate: of the update loop [Hz].
            frame: odom, as tf names it.
        """
        self._every = max(1, round(rate / RATE))
        self._state_every = max(1, round(rate / STATE_RATE))
        self._cycle = 0
        self._points = []
        for name in POINTS:
            message = PointStamped()
            message.header.stamp, message.header.frame_id = stamp, frame
            self._points.append((node.create_publisher(PointStamped, f"flor/state/{name}", 5), message))
        there = (True, True, hands.left is not None, hands.right is not None)
        self._contacts = [
            node.create_publisher(Bool, f"flor/{limb}/contact", LATCHED) if has else None
            for limb, has in zip(TOUCHING, there, strict=True)
        ]
        self._touching: list[int | None] = [None] * len(TOUCHING)
        self._state = TwinPublisher(node, RosMotionState, "flor/controller/motion_state", LATCHED)
        self._behavior = ""

    def publish(self, received: Received[MotionState] | None) -> None:
        """Publish what is due in this cycle."""
        if received is None:
            return
        motion = received.message
        touching = motion.contacts.tolist() + motion.hand_contacts.tolist()
        if touching != self._touching:
            for publisher, before, now in zip(self._contacts, self._touching, touching, strict=True):
                if publisher and before != now:
                    publisher.publish(Bool(data=bool(now)))
            self._touching = touching
        self._cycle += 1
        if self._cycle % self._state_every == 0 or motion.behavior != self._behavior:
            self._behavior = motion.behavior
            self._state.publish(received)
        if self._cycle % self._every:
            return
        cop = np.append(motion.cop_in_odom, 0.0)
        places = (motion.com_in_odom, motion.dcm_in_odom, motion.dcm_reference_in_odom, cop)
        for (publisher, message), place in zip(self._points, places, strict=True):
            message.point.x, message.point.y, message.point.z = map(float, place)
            publisher.publish(message)
