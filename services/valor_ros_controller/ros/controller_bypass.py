"""Controller bypass (thesis figure 4.1): commands that pass the controllers by, from ROS straight to the Motion System.

/cmd_vel (geometry_msgs/Twist) ─► motion_manager/velocity      while the control mode walks
"""

from __future__ import annotations

from geometry_msgs.msg import Twist
from rclpy.node import Node

import bifrost
from valor_common.messages import VelocityCommand
from valor_common.topics import VELOCITY
from valor_ros_controller.realtime_buffer import RealTimeBuffer

TOPIC = "/cmd_vel"
WALKING = frozenset({"walk", "walk_manipulate"})  # control modes


class ControllerBypass:
    """Hands walking velocities over; whether they are followed is for the Motion Manager to say.

    Its callback runs in the ROS thread, ``update`` in the update thread.
    """

    def __init__(self, ros: Node, node: bifrost.Node) -> None:
        self._newest: RealTimeBuffer[Twist] = RealTimeBuffer()
        self._velocity = node.publisher(VELOCITY.name, VelocityCommand)
        self._subscription = ros.create_subscription(Twist, TOPIC, self._newest.write, 1)

    def update(self, control_mode: str, time: int) -> None:
        """Pass on what is new, in a control mode that walks, at robot time ``time`` [ns]."""
        twist = self._newest.read()
        if twist is None or control_mode not in WALKING:
            return
        self._velocity.publish(
            VelocityCommand(time=time, linear_x=twist.linear.x, linear_y=twist.linear.y, angular_z=twist.angular.z)
        )
