"""Controller bypass (thesis figure 4.1): commands that pass the controllers by, from ROS straight to the Motion System.

    /cmd_vel (geometry_msgs/Twist)                              ─► motion_manager/velocity         in modes that walk
    /flor/{l,r}_hand/goal_pose (geometry_msgs/PoseStamped)      ─► motion_manager/hand_goal
    /flor/{l,r}_hand/goal_cancel (std_msgs/Empty)               ─► motion_manager/hand_goal
    /flor/controller/joint_gains (valor_msgs/JointGains)        ─► motion_manager/joint_gains
    /flor/controller/balance_weights (valor_msgs/BalanceWeights) ─► motion_manager/balance_weights

Whether they are obeyed is for the Motion Manager to say (``motion_manager/rejection``).
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.node import Node
from std_msgs.msg import Empty
from valor_msgs.msg import BalanceWeights as RosBalanceWeights
from valor_msgs.msg import JointGains as RosJointGains

import bifrost
from valor_common.messages import BalanceWeights, HandGoal, JointGains, VelocityCommand
from valor_common.topics import BALANCE_WEIGHTS, HAND_GOAL, JOINT_GAINS, VELOCITY
from valor_ros_controller.realtime_buffer import RealTimeBuffer

_log = logging.getLogger("controller_bypass")

TOPIC = "/cmd_vel"
WALKING = frozenset({"walk", "walk_manipulate"})  # control modes
HANDS = ("l_hand", "r_hand")
QUEUE = 10  # commands on demand that wait for the update loop; more, and the oldest are let go


class ControllerBypass:
    """Hands commands over.

    Its callbacks run in the ROS thread, ``update`` in the update thread.

    Attributes:
        rejected: commands that could not be handed over.
    """

    def __init__(self, ros: Node, node: bifrost.Node, base_frames: tuple[str, ...]) -> None:
        """Open the interfaces.

        Args:
            ros: the ROS node.
            node: to the Bifrost network.
            base_frames: names of the pelvis' frame.
        """
        self.rejected = 0
        self._frames = dict.fromkeys(base_frames, "pelvis") | {"odom": "odom"}
        self._newest: RealTimeBuffer[Twist] = RealTimeBuffer()
        self._waiting: deque[Callable[[int], object]] = deque(maxlen=QUEUE)
        self._velocity = node.publisher(VELOCITY.name, VelocityCommand)
        self._hand_goal = node.publisher(HAND_GOAL.name, HandGoal)
        self._gains = node.publisher(JOINT_GAINS.name, JointGains)
        self._weights = node.publisher(BALANCE_WEIGHTS.name, BalanceWeights)
        ros.create_subscription(Twist, TOPIC, self._newest.write, 1)
        for hand, name in enumerate(HANDS):
            ros.create_subscription(PoseStamped, f"/flor/{name}/goal_pose", partial(self._lead, hand), 1)
            ros.create_subscription(Empty, f"/flor/{name}/goal_cancel", partial(self._release, hand), 1)
        ros.create_subscription(RosJointGains, "/flor/controller/joint_gains", self._tune_gains, 1)
        ros.create_subscription(RosBalanceWeights, "/flor/controller/balance_weights", self._tune_weights, 1)

    def update(self, control_mode: str, time: int) -> None:
        """Pass on what is new, at robot time ``time`` [ns]."""
        while self._waiting:
            self._waiting.popleft()(time)
        twist = self._newest.read()
        if twist is None or control_mode not in WALKING:
            return
        self._velocity.publish(
            VelocityCommand(time=time, linear_x=twist.linear.x, linear_y=twist.linear.y, angular_z=twist.angular.z)
        )

    def _lead(self, hand: int, message: Any) -> None:
        frame = self._frames.get(message.header.frame_id)
        if frame is None:
            self.rejected += 1
            _log.warning(
                "/flor/%s/goal_pose refused: frame %r; expected one of %s",
                HANDS[hand],
                message.header.frame_id,
                ", ".join(self._frames),
            )
            return
        p, q = message.pose.position, message.pose.orientation
        position, orientation = np.array((p.x, p.y, p.z)), np.array((q.w, q.x, q.y, q.z))
        self._waiting.append(
            lambda time: self._hand_goal.publish(HandGoal(time, hand, True, frame, position, orientation))
        )

    def _release(self, hand: int, _: Any) -> None:
        nothing = np.zeros(0)
        self._waiting.append(lambda time: self._hand_goal.publish(HandGoal(time, hand, False, "", nothing, nothing)))

    def _tune_gains(self, message: Any) -> None:
        gains = JointGains(list(message.names), np.array(message.stiffness), np.array(message.damping))
        self._waiting.append(lambda _: self._gains.publish(gains))

    def _tune_weights(self, message: Any) -> None:
        weights = BalanceWeights(list(message.names), np.array(message.weights))
        self._waiting.append(lambda _: self._weights.publish(weights))
