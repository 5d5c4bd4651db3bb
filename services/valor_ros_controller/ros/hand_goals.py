"""Cartesian goals of the hands on ROS; the Motion Manager leads them.

    /flor/{l,r}_hand/goal_pose (geometry_msgs/PoseStamped)   ─► motion_manager/hand_goal
    /flor/{l,r}_hand/goal_cancel (std_msgs/Empty)            ─► motion_manager/hand_goal
    /flor/{l,r}_hand/goal_status (valor_msgs/HandGoalStatus) ◄─ motion_manager/hand_goal_status

A goal takes its arm from the trajectory that runs, whose sender is told; who sent the goal is told by its status.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from std_msgs.msg import Empty
from valor_msgs.msg import HandGoalStatus as RosHandGoalStatus

import bifrost
from valor.common.messages import HandGoal, HandGoalStatus
from valor.common.topics import HAND_GOAL as HAND_GOAL_TOPIC
from valor.common.topics import HAND_GOAL_STATUS
from valor.ros.limbs import HANDS
from valor.valor_ros_controller.ros.node import LATCHED
from valor.valor_ros_controller.ros.rejections import Rejections
from valor.valor_ros_controller.ros.twin_publisher import TwinPublisher
from valor.valor_ros_controller.valor_escher_hw_interface import HAND_GOAL, ValorEscherHWInterface

GOAL_POSE, GOAL_CANCEL, GOAL_STATUS = (f"flor/{{}}/goal_{what}" for what in ("pose", "cancel", "status"))
QUEUE = 50  # of statuses
AT_ONCE = 10
IDLE = "idle"  # as HandGoalStatus says of a hand that no goal leads

Command = Callable[[ValorEscherHWInterface], object]
"""What is done with a message in the update thread."""


class HandGoals:
    """Callbacks run in the ROS thread, all else in the update thread.

    Attributes:
        heard: what it listens to.
    """

    def __init__(self, ros: Node, node: bifrost.Node, frames: dict[str, str], rejections: Rejections) -> None:
        """Open the topics of statuses.

        Args:
            ros: the ROS node.
            node: to the Bifrost network.
            frames: ROS' name of a frame → the Motion Manager's.
            rejections: where refusals are told.
        """
        self._frames, self._rejections, self._origin = frames, rejections, node.name
        self._goal = HAND_GOAL_TOPIC.publisher(node)
        self.heard = HAND_GOAL_STATUS.subscriber(node, queue=QUEUE)
        self._publishers = [TwinPublisher(ros, RosHandGoalStatus, GOAL_STATUS.format(hand), LATCHED) for hand in HANDS]
        self._led: set[int] = set()  # hands to which a goal was handed over since they were let go
        self._newest: list[bifrost.Received[HandGoalStatus] | None] = [None] * len(HANDS)

    def commands(self) -> list[tuple[type, str, Callable[[Any], Command]]]:
        """Of each topic that is to be subscribed to: type, name, and what its messages become."""
        return [
            command
            for hand, name in enumerate(HANDS)
            for command in (
                (PoseStamped, GOAL_POSE.format(name), partial(self._lead, hand)),
                (Empty, GOAL_CANCEL.format(name), partial(self._release, hand)),
            )
        ]

    def publish(self, silent: str) -> None:
        """What is new; of a goal whose leader is silent (its name; empty: it is not), that it is over."""
        for status in self.heard.drain(AT_ONCE):
            if 0 <= status.message.hand < len(HANDS):
                self._tell(status)
        if silent:
            for newest in self._newest:
                if newest and newest.message.state != IDLE:
                    over = HandGoalStatus(
                        newest.message.time, newest.message.hand, IDLE, f"{silent} is silent", 0.0, 0.0
                    )
                    self._tell(bifrost.Received(over, 0, newest.sequence, self._origin))

    def release_all(self, hw: ValorEscherHWInterface) -> None:
        """Have the arms stay where they are, also those of goals that the Motion System has not told of yet."""
        leaders = (hw.motion.left_arm, hw.motion.right_arm) if hw.motion else ()
        led = {hand for hand, leader in enumerate(leaders) if leader == HAND_GOAL}
        for hand in sorted(led | self._led):
            self._release(hand, None)(hw)

    def _tell(self, status: bifrost.Received[HandGoalStatus]) -> None:
        self._newest[status.message.hand] = status
        self._publishers[status.message.hand].publish(status)

    def _lead(self, hand: int, message: Any) -> Command:
        p, q, frame = message.pose.position, message.pose.orientation, message.header.frame_id
        position, orientation = np.array((p.x, p.y, p.z)), np.array((q.w, q.x, q.y, q.z))

        def hand_over(hw: ValorEscherHWInterface) -> None:
            known = self._frames.get(frame)
            if known is None:
                expected = ", ".join(self._frames)
                reason = f"frame {frame[:64]!r}; expected one of {expected}"
                self._rejections.refuse(GOAL_POSE.format(HANDS[hand]), reason)
            else:
                self._goal.publish(HandGoal(hw.time, hand, True, known, position, orientation))
                self._led.add(hand)

        return hand_over

    def _release(self, hand: int, _: Any) -> Command:
        nothing = np.zeros(0)

        def let_go(hw: ValorEscherHWInterface) -> None:
            self._goal.publish(HandGoal(hw.time, hand, False, "", nothing, nothing))
            self._led.discard(hand)

        return let_go
