"""Controller bypass (thesis figure 4.1): what passes the controllers by, between ROS and the Motion System.

    /cmd_vel (geometry_msgs/Twist)                                ─► motion_manager/velocity   in modes that walk
    /flor/pelvis_controller/goal_pose (geometry_msgs/PoseStamped) ─► motion_manager/pelvis     unless a controller leads
    /flor/{l,r}_hand/goal_pose (geometry_msgs/PoseStamped)        ─► motion_manager/hand_goal
    /flor/{l,r}_hand/goal_cancel (std_msgs/Empty)                 ─► motion_manager/hand_goal
    /flor/controller/joint_gains (valor_msgs/JointGains)          ─► motion_manager/joint_gains
    /flor/controller/balance_weights (valor_msgs/BalanceWeights)  ─► motion_manager/balance_weights
    /flor/controller/soft_stop (std_msgs/Empty)                   ─► control mode soft_stop
    /flor/{l,r}_hand/goal_status (valor_msgs/HandGoalStatus)      ◄─ motion_manager/hand_goal_status
    /flor/controller/rejection (valor_msgs/Rejection)             ◄─ motion_manager/rejection

Whether commands are obeyed is for the Motion Manager to say, and it says so in ``rejection``. What is refused here
already is told there too.
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
from valor_msgs.msg import HandGoalStatus as RosHandGoalStatus
from valor_msgs.msg import JointGains as RosJointGains
from valor_msgs.msg import Rejection as RosRejection

import bifrost
from valor.common.behaviors import WALKING_MODES
from valor.common.messages import (
    BalanceWeights,
    HandGoal,
    JointGains,
    Rejection,
    VelocityCommand,
)
from valor.common.rotation import NORM, roll_pitch_yaw
from valor.common.topics import (
    BALANCE_WEIGHTS,
    HAND_GOAL,
    HAND_GOAL_STATUS,
    JOINT_GAINS,
    REJECTION,
    VELOCITY,
)
from valor.valor_ros_controller.realtime_buffer import RealTimeBuffer
from valor.valor_ros_controller.ros.node import LATCHED
from valor.valor_ros_controller.ros.twin_publisher import TwinPublisher
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface
from valor.valor_ros_controller.valor_escher_interface import ValorEscherInterface

_log = logging.getLogger("controller_bypass")

CMD_VEL = "/cmd_vel"
PELVIS_GOAL = "/flor/pelvis_controller/goal_pose"
SUPPORT = "support"
"""The frame of pelvis goals: that of ``PelvisSetpoint``."""
HANDS = ("l_hand", "r_hand")
QUEUE = 10  # commands on demand that wait for the update loop; more, and the oldest are let go
AT_ONCE = 2  # of them, in one cycle
LOOK = 5  # what comes back from the Motion System is looked for at every so many cycles


class ControllerBypass:
    """Hands commands over.

    Its callbacks run in the ROS thread, ``update`` in the update thread.

    Attributes:
        rejected: commands that could not be handed over.
        refusals: commands of anybody's that the Motion Manager or this refused.
        last_refusal: the newest of them: topic and reason.
    """

    def __init__(
        self,
        ros: Node,
        node: bifrost.Node,
        interface: ValorEscherInterface,
        base_frames: tuple[str, ...],
        *,
        soft_stop: Callable[[], None],
        refusal: str = "",
    ) -> None:
        """Open the interfaces.

        Args:
            ros: the ROS node.
            node: to the Bifrost network.
            interface: the one that tells the Motion System where the pelvis shall be.
            base_frames: names of the pelvis' frame.
            soft_stop: asks for control mode soft_stop, from any thread.
            refusal: why no command is handed over; empty: they are.
        """
        self.rejected = 0
        self.refusals = 0
        self.last_refusal = ""
        self._origin = node.name
        self._interface = interface
        self._frames = dict.fromkeys(base_frames, "pelvis") | {"odom": "odom"}
        self._cycle = 0
        self._newest: RealTimeBuffer[Twist] = RealTimeBuffer()
        self._waiting: deque[Callable[[ValorEscherHWInterface], object]] = deque(maxlen=QUEUE)
        self._velocity = VELOCITY.publisher(node)
        self._hand_goal = HAND_GOAL.publisher(node)
        self._gains = JOINT_GAINS.publisher(node)
        self._weights = BALANCE_WEIGHTS.publisher(node)
        self._statuses = HAND_GOAL_STATUS.subscriber(node, queue=5 * QUEUE)
        self._rejections = REJECTION.subscriber(node, queue=5 * QUEUE)
        self.heard = (self._statuses, self._rejections)
        commands: list[tuple[type, str, Callable[[Any], None]]] = [
            (Twist, CMD_VEL, self._newest.write),
            (PoseStamped, PELVIS_GOAL, self._move_pelvis),
            (Empty, "/flor/controller/soft_stop", lambda _: soft_stop()),
            (RosJointGains, "/flor/controller/joint_gains", self._tune_gains),
            (RosBalanceWeights, "/flor/controller/balance_weights", self._tune_weights),
        ]
        for hand, name in enumerate(HANDS):
            commands.append((PoseStamped, f"/flor/{name}/goal_pose", partial(self._lead, hand)))
            commands.append((Empty, f"/flor/{name}/goal_cancel", partial(self._release, hand)))
        for kind, topic, obey in commands:
            ros.create_subscription(kind, topic, self._refusing(topic, refusal) if refusal else obey, 1)
        self._hand_status = [
            TwinPublisher(ros, RosHandGoalStatus, f"/flor/{name}/goal_status", LATCHED) for name in HANDS
        ]
        self._rejection = TwinPublisher(ros, RosRejection, "/flor/controller/rejection", QUEUE)

    def update(self, control_mode: str, hw: ValorEscherHWInterface) -> None:
        """Pass on what is new, both ways."""
        for _ in range(min(len(self._waiting), AT_ONCE)):
            self._waiting.popleft()(hw)
        self._cycle = (self._cycle + 1) % LOOK
        if self._cycle == 0:
            for status in self._statuses.drain(QUEUE):
                if 0 <= status.message.hand < len(HANDS):
                    self._hand_status[status.message.hand].publish(status)
            for rejection in self._rejections.drain(QUEUE):
                self._tell(rejection)
        twist = self._newest.read()
        if twist is None or control_mode not in WALKING_MODES:
            return
        self._velocity.publish(
            VelocityCommand(time=hw.time, linear_x=twist.linear.x, linear_y=twist.linear.y, angular_z=twist.angular.z)
        )

    def _refusing(self, topic: str, reason: str) -> Callable[[Any], None]:
        """What refuses whatever comes."""
        return lambda _: self._waiting.append(lambda _: self._refuse(topic, reason))

    def _refuse(self, topic: str, reason: str) -> None:
        """Count a command that is not handed over, and say so. Update thread."""
        self.rejected += 1
        if self.last_refusal != f"{topic}: {reason}":  # told once in the log, however often it is sent
            _log.warning("%s refused: %s", topic, reason)
        rejection = Rejection(topic=topic, origin=self._origin, reason=reason, count=self.rejected)
        self._tell(bifrost.Received(rejection, 0, self.rejected, self._origin))

    def _tell(self, rejection: bifrost.Received[Rejection]) -> None:
        self.refusals += 1
        self.last_refusal = f"{rejection.message.topic}: {rejection.message.reason}"
        self._rejection.publish(rejection)

    def _move_pelvis(self, message: Any) -> None:
        p, q = message.pose.position, message.pose.orientation
        quaternion, frame = (q.w, q.x, q.y, q.z), message.header.frame_id

        def hand_over(hw: ValorEscherHWInterface) -> None:
            if frame != SUPPORT:
                self._refuse(PELVIS_GOAL, f"frame {frame[:64]!r}; expected {SUPPORT!r}")
            elif not abs(np.linalg.norm(quaternion) - 1.0) <= NORM:
                self._refuse(PELVIS_GOAL, "the orientation is no unit quaternion")
            elif leader := hw.claims.get(hw.pelvis):
                self._refuse(PELVIS_GOAL, f"{leader} leads the pelvis in {hw.situation}")
            else:
                position = np.array((p.x, p.y, p.z, *roll_pitch_yaw(quaternion)))
                self._interface.lead_pelvis(position, np.zeros(6))

        self._waiting.append(hand_over)

    def _lead(self, hand: int, message: Any) -> None:
        p, q, frame = message.pose.position, message.pose.orientation, message.header.frame_id
        position, orientation = np.array((p.x, p.y, p.z)), np.array((q.w, q.x, q.y, q.z))

        def hand_over(hw: ValorEscherHWInterface) -> None:
            known = self._frames.get(frame)
            if known is None:
                expected = ", ".join(self._frames)
                self._refuse(f"/flor/{HANDS[hand]}/goal_pose", f"frame {frame[:64]!r}; expected one of {expected}")
            else:
                self._hand_goal.publish(HandGoal(hw.time, hand, True, known, position, orientation))

        self._waiting.append(hand_over)

    def _release(self, hand: int, _: Any) -> None:
        nothing = np.zeros(0)
        self._waiting.append(lambda hw: self._hand_goal.publish(HandGoal(hw.time, hand, False, "", nothing, nothing)))

    def _tune_gains(self, message: Any) -> None:
        gains = JointGains(list(message.names), np.array(message.stiffness), np.array(message.damping))
        self._waiting.append(lambda _: self._gains.publish(gains))

    def _tune_weights(self, message: Any) -> None:
        weights = BalanceWeights(list(message.names), np.array(message.weights))
        self._waiting.append(lambda _: self._weights.publish(weights))
