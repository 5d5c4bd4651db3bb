"""Controller bypass (thesis figure 4.1): what passes the controllers by, between ROS and the Motion System.

    /cmd_vel (geometry_msgs/Twist)                                ─► motion_manager/velocity   in modes that walk
    /flor/pelvis_controller/goal_pose (geometry_msgs/PoseStamped) ─► motion_manager/pelvis     unless a controller leads
    /flor/{l,r}_hand/goal_… (``hand_goals``)                      ─► motion_manager/hand_goal
    /flor/controller/joint_gains (valor_msgs/JointGains)          ─► motion_manager/joint_gains
    /flor/controller/balance_weights (valor_msgs/BalanceWeights)  ─► motion_manager/balance_weights
    /flor/controller/soft_stop (std_msgs/Empty)                   ─► control mode soft_stop
    /flor/controller/rejection (``rejections``)                   ◄─ motion_manager/rejection

Whether commands are obeyed is for the Motion Manager to say, and it says so in ``rejection``. What is refused here
already is told there too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.node import Node
from std_msgs.msg import Empty
from valor_msgs.msg import BalanceWeights as RosBalanceWeights
from valor_msgs.msg import JointGains as RosJointGains

import bifrost
from valor.common.behaviors import WALKING_MODES
from valor.common.messages import BalanceWeights, JointGains, VelocityCommand
from valor.common.rotation import NORM, roll_pitch_yaw
from valor.common.topics import BALANCE_WEIGHTS, JOINT_GAINS, VELOCITY
from valor.valor_ros_controller.realtime_buffer import RealTimeBuffer
from valor.valor_ros_controller.ros.hand_goals import Command, HandGoals
from valor.valor_ros_controller.ros.rejections import Rejections
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface
from valor.valor_ros_controller.valor_escher_interface import ValorEscherInterface

CMD_VEL = "cmd_vel"
PELVIS_GOAL = "flor/pelvis_controller/goal_pose"
GAINS = "flor/controller/joint_gains"
WEIGHTS = "flor/controller/balance_weights"
SUPPORT = "support"
"""The frame of pelvis goals: that of ``PelvisSetpoint``."""
QUEUE = 10  # commands on demand that wait for the update loop; more, and the oldest are let go
AT_ONCE = 2  # of them, in one cycle
LOOK = 5  # what comes back from the Motion System is looked for at every so many cycles


class ControllerBypass:
    """Hands commands over.

    Its callbacks run in the ROS thread, ``update`` in the update thread.

    Attributes:
        rejections: where refusals are told.
    """

    def __init__(
        self,
        ros: Node,
        node: bifrost.Node,
        interface: ValorEscherInterface,
        frames: Mapping[str, str],
        *,
        soft_stop: Callable[[], None],
        refusal: str = "",
    ) -> None:
        """Open the interfaces.

        Args:
            ros: the ROS node.
            node: to the Bifrost network.
            interface: the one that tells the Motion System where the pelvis shall be.
            frames: of hands' goals, by their names in tf: the Motion Manager's names.
            soft_stop: asks for control mode soft_stop, from any thread.
            refusal: why no command is handed over; empty: they are.
        """
        self.rejections = Rejections(ros, node)
        self._interface = interface
        self._hands = HandGoals(ros, node, dict(frames), self.rejections)
        self._cycle = 0
        self._stops = 0
        self._newest: RealTimeBuffer[Twist] = RealTimeBuffer()
        self._waiting: deque[tuple[str, Command]] = deque(maxlen=QUEUE)
        self._velocity = VELOCITY.publisher(node)
        self._gains = JOINT_GAINS.publisher(node)
        self._weights = BALANCE_WEIGHTS.publisher(node)
        self.heard = (self._hands.heard, self.rejections.heard)
        commands: list[tuple[type, str, Callable[[Any], None]]] = [
            (Twist, CMD_VEL, self._newest.write),
            (PoseStamped, PELVIS_GOAL, self._move_pelvis),
            (Empty, "flor/controller/soft_stop", lambda _: soft_stop()),
            (RosJointGains, GAINS, self._tune_gains),
            (RosBalanceWeights, WEIGHTS, self._tune_weights),
        ]
        commands += [(kind, topic, self._queued(topic, command)) for kind, topic, command in self._hands.commands()]
        for kind, topic, obey in commands:
            ros.create_subscription(kind, topic, self._refusing(topic, refusal) if refusal else obey, 1)

    def report(self, *, measured: bool) -> None:
        """Pass on what comes back from the Motion System, now and then; ``measured``: the robot speaks."""
        if self._interface.silent:
            self._let_go(self._interface.silent)
        self._cycle = (self._cycle + 1) % LOOK
        if self._cycle == 0 or not measured:
            self._hands.publish(self._interface.silent)
            self.rejections.publish()

    def update(self, control_mode: str, hw: ValorEscherHWInterface, stops: int) -> None:
        """Pass on what has come for the Motion System; ``stops``: how often mode stop was entered."""
        stopped, self._stops = stops != self._stops, stops
        for _ in range(len(self._waiting) if stopped else min(len(self._waiting), AT_ONCE)):
            _, hand_over = self._waiting.popleft()
            hand_over(hw)
        if stopped:
            self._hands.release_all(hw)  # the trajectories of the arms have ended, too
        twist = self._newest.read()
        if twist is None or control_mode not in WALKING_MODES:
            return
        self._velocity.publish(
            VelocityCommand(time=hw.time, linear_x=twist.linear.x, linear_y=twist.linear.y, angular_z=twist.angular.z)
        )

    def _let_go(self, silent: str) -> None:
        """What came while the robot is silent is not for the time when it speaks again."""
        reason = f"{silent} is silent"
        if self._newest.read() is not None:
            self._refuse(CMD_VEL, reason)
        while self._waiting:
            topic, _ = self._waiting.popleft()
            self._refuse(topic, reason)

    def _refusing(self, topic: str, reason: str) -> Callable[[Any], None]:
        """What refuses whatever comes."""
        return lambda _: self._wait(topic, lambda _: self._refuse(topic, reason))

    def _queued(self, topic: str, command: Callable[[Any], Command]) -> Callable[[Any], None]:
        """What puts a message's command before the update thread."""
        return lambda message: self._wait(topic, command(message))

    def _wait(self, topic: str, hand_over: Command) -> None:
        self._waiting.append((topic, hand_over))

    def _refuse(self, topic: str, reason: str) -> None:
        self.rejections.refuse(topic, reason)

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

        self._wait(PELVIS_GOAL, hand_over)

    def _tune_gains(self, message: Any) -> None:
        gains = JointGains(list(message.names), np.array(message.stiffness), np.array(message.damping))
        self._wait(GAINS, lambda _: self._gains.publish(gains))

    def _tune_weights(self, message: Any) -> None:
        weights = BalanceWeights(list(message.names), np.array(message.weights))
        self._wait(WEIGHTS, lambda _: self._weights.publish(weights))
