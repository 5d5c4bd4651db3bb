"""Controller bypass (thesis figure 4.1): commands between ROS and the Motion System that bypass the controllers.

Velocity, set-points of the pelvis, goals of the hands, gains, weights, soft stop. The Motion System accepts or rejects
commands; ``rejection`` has its rejections and those of this module.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Empty, String
from valor_msgs.msg import BalanceWeights as RosBalanceWeights
from valor_msgs.msg import HandGoalStatus as RosHandGoalStatus
from valor_msgs.msg import JointGains as RosJointGains
from valor_msgs.msg import Rejection as RosRejection

import bifrost
from valor.common.arrays import FloatArray
from valor.common.behaviors import WALKING_MODES
from valor.common.messages import BalanceWeights, HandGoal, HandGoalStatus, JointGains, Rejection, VelocityCommand
from valor.common.rotation import NORM, roll_pitch_yaw
from valor.common.topics import BALANCE_WEIGHTS, HAND_GOAL_STATUS, JOINT_GAINS, REJECTION, VELOCITY
from valor.common.topics import HAND_GOAL as HAND_GOAL_TOPIC
from valor.ros.controllers import COMMAND
from valor.ros.limbs import HANDS
from valor.ros.mirror import MirrorPublisher, from_ros
from valor.valor_ros_controller.realtime_buffer import RealTimeBuffer
from valor.valor_ros_controller.rejection_log import BoundedLog, RejectionLog
from valor.valor_ros_controller.ros.node import LATCHED, CommandNode
from valor.valor_ros_controller.ros.stamped_velocity import StampedVelocity
from valor.valor_ros_controller.valor_escher_hw_interface import HAND_GOAL, ValorEscherHWInterface
from valor.valor_ros_controller.valor_escher_interface import ValorEscherInterface

CMD_VEL = "cmd_vel"
PELVIS_GOAL = "flor/pelvis_controller/goal_pose"
GAINS = "flor/controller/joint_gains"
WEIGHTS = "flor/controller/balance_weights"
GOAL_POSE, GOAL_CANCEL, GOAL_STATUS = (f"flor/{{}}/goal_{what}" for what in ("pose", "cancel", "status"))
SUPPORT = "support"  # frame of pelvis goals, as of PelvisSetpoint
QUEUE = 10  # commands waiting for the update loop; the oldest are dropped
MAX_PER_CYCLE = 2  # of these
POLL_CYCLES = 5  # between two polls of messages from the Motion System
STATUS_QUEUE = 50  # statuses of hand goals
MAX_STATUSES = 10  # of these, per poll
REJECTION_QUEUE = 50  # rejections of the Motion Manager
MAX_REJECTIONS = 10  # of these, per poll
LAST_TEN = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
IDLE = "idle"  # state of HandGoalStatus without a goal
_log = logging.getLogger("rejections")

Command = Callable[[ValorEscherHWInterface], object]
"""Action of a message in the update thread."""


class RejectionPublisher:
    """``/flor/controller/rejection``: commands of topics rejected by Motion Manager and VRC. Update thread."""

    def __init__(self, ros: Node, node: bifrost.Node) -> None:
        self._origin, self._resolved = node.name, ros.resolve_topic_name
        self.subscriber = REJECTION.subscriber(node, queue=REJECTION_QUEUE)  # to the Motion Manager's rejections
        self._publisher = MirrorPublisher(ros, RosRejection, "flor/controller/rejection", LAST_TEN)
        self._sources: list[tuple[str, RejectionLog]] = []
        self.own = RejectionLog(BoundedLog(_log), "{}")  # commands of topics rejected by the VRC
        self._log = BoundedLog(_log)  # of the Motion System: it has no other way to /rosout
        self.count = 0  # of all rejections published
        self.last = ""  # topic and reason of the latest

    def add_source(self, topic: str, rejections: RejectionLog) -> None:
        """Publish rejections of requests received on a topic."""
        self._sources.append((self._resolved(topic), rejections))

    def reject(self, topic: str, reason: str) -> None:
        topic = self._resolved(topic)
        self.own.add(topic, reason, answered=True)
        self._publish_own(topic, reason, self.own.count)

    def publish(self) -> None:
        for rejection in self.subscriber.drain(MAX_REJECTIONS):
            message = rejection.message
            self._log.warning(f"{message.topic} of {message.origin} rejected: {message.reason}")
            self._publish(rejection)
        for topic, rejections in self._sources:
            for reason, count in rejections.drain():
                self._publish_own(topic, reason, count)

    def _publish_own(self, topic: str, reason: str, count: int) -> None:
        rejection = Rejection(topic=topic, origin=self._origin, reason=reason, count=count)
        self._publish(bifrost.Received(rejection, 0, count, self._origin))

    def _publish(self, rejection: bifrost.Received[Rejection]) -> None:
        self.count += 1
        self.last = f"{rejection.message.topic}: {rejection.message.reason}"
        self._publisher.publish(rejection)


class ControllerBypass:
    """Forwards commands. Callbacks run in the ROS thread, ``update`` and ``report`` in the update thread."""

    def __init__(
        self,
        ros: CommandNode,
        node: bifrost.Node,
        interface: ValorEscherInterface,
        frames: Mapping[str, str],
        *,
        soft_stop: Callable[[], None],
        choose: Callable[[str], None],
        rejection: str = "",
    ) -> None:
        """Open the interfaces.

        ``frames``: of hand goals, names of the Motion Manager by names in tf; ``soft_stop``: requests that mode, from
        any thread; ``choose``: requests a controller; ``rejection``: reason to reject every command, empty if
        there is none.
        """
        self.rejections = RejectionPublisher(ros, node)  # publisher of rejections
        self._interface = interface
        self._hands = _HandGoals(ros, node, frames, self.rejections)
        self._cycle = 0
        self._stops = 0
        self._twist: RealTimeBuffer[Twist] = RealTimeBuffer()
        self._stamped_twist: RealTimeBuffer[TwistStamped] = RealTimeBuffer()  # of another thread
        self._queue: deque[tuple[str, Command]] = deque(maxlen=QUEUE)
        self._velocity = VELOCITY.publisher(node)
        self.subscribers = (self._hands.subscriber, self.rejections.subscriber)  # Bifrost subscribers
        callbacks: list[tuple[type, str, Callable[[Any], None]]] = [
            (Twist, CMD_VEL, self._twist.write),
            (Empty, "flor/controller/soft_stop", lambda _: soft_stop()),
        ]
        commands: list[tuple[type, str, Callable[[Any], Command]]] = [
            (PoseStamped, PELVIS_GOAL, self._pelvis_command),
            (RosJointGains, GAINS, partial(self._mirrored, JOINT_GAINS.publisher(node), JointGains)),
            (RosBalanceWeights, WEIGHTS, partial(self._mirrored, BALANCE_WEIGHTS.publisher(node), BalanceWeights)),
            (String, COMMAND, lambda message: lambda _: choose(message.data)),
            *self._hands.commands(),
        ]
        callbacks += [(kind, topic, self._queued(topic, command)) for kind, topic, command in commands]
        for kind, topic, callback in callbacks:
            ros.create_subscription(kind, topic, self._rejecting(topic, rejection) if rejection else callback, 1)
        stamped = self._rejecting(CMD_VEL, rejection) if rejection else self._stamped_twist.write
        StampedVelocity(ros, ros.resolve_topic_name(CMD_VEL), ros.checked(CMD_VEL, stamped))

    def report(self, *, measured: bool) -> None:
        """Publish messages of the Motion System every ``POLL_CYCLES``; ``measured``: the robot is not silent."""
        if self._interface.silent:
            self._drop(self._interface.silent)
        self._cycle = (self._cycle + 1) % POLL_CYCLES
        if self._cycle == 0 or not measured:
            self._hands.publish(self._interface.silent)
            self.rejections.publish()

    def update(self, control_mode: str, hw: ValorEscherHWInterface, stops: int) -> None:
        """Forward received commands; ``stops``: number of entries to mode stop."""
        stopped, self._stops = stops != self._stops, stops
        for _ in range(len(self._queue) if stopped else min(len(self._queue), MAX_PER_CYCLE)):
            _, forward = self._queue.popleft()
            forward(hw)
        if stopped:
            self._hands.cancel_all(hw)  # the arms' trajectories have ended, too
        for time, twist in self._velocities(hw.time):
            if control_mode in WALKING_MODES:
                x, y, turn = twist.linear.x, twist.linear.y, twist.angular.z
                self._velocity.publish(VelocityCommand(time=time, linear_x=x, linear_y=y, angular_z=turn))

    def _velocities(self, now: int) -> Iterator[tuple[int, Twist]]:
        """Received velocities with their times: their stamps, or ``now`` [ns]."""
        if (twist := self._twist.read()) is not None:
            yield now, twist
        if (stamped := self._stamped_twist.read()) is not None:
            stamp = stamped.header.stamp
            yield stamp.sec * 10**9 + stamp.nanosec or now, stamped.twist

    def _drop(self, silent: str) -> None:
        """Reject waiting commands: they must not execute after the silence."""
        reason = f"{silent} is silent"
        for _ in self._velocities(0):
            self.rejections.reject(CMD_VEL, reason)
        while self._queue:
            topic, _ = self._queue.popleft()
            self.rejections.reject(topic, reason)

    def _rejecting(self, topic: str, reason: str) -> Callable[[Any], None]:
        return lambda _: self._queue.append((topic, lambda _: self.rejections.reject(topic, reason)))

    def _queued(self, topic: str, command: Callable[[Any], Command]) -> Callable[[Any], None]:
        return lambda message: self._queue.append((topic, command(message)))

    def _pelvis_command(self, message: Any) -> Command:
        frame, position, quaternion = _pose(message)

        def forward(hw: ValorEscherHWInterface) -> None:
            if frame != SUPPORT:
                self.rejections.reject(PELVIS_GOAL, f"frame {frame[:64]!r}; expected {SUPPORT!r}")
            elif not abs(np.linalg.norm(quaternion) - 1.0) <= NORM:
                self.rejections.reject(PELVIS_GOAL, "orientation: expected a unit quaternion")
            elif owner := hw.claims.get(hw.pelvis):
                self.rejections.reject(PELVIS_GOAL, f"{owner} controls the pelvis in {hw.situation}")
            else:
                w, x, y, z = quaternion.tolist()
                self._interface.command_pelvis(np.array((*position, *roll_pitch_yaw((w, x, y, z)))), np.zeros(6))

        return forward

    @staticmethod
    def _mirrored(publisher: bifrost.Publisher[Any], kind: type[bifrost.Message], message: Any) -> Command:
        mirrored = from_ros(kind, message)
        return lambda _: publisher.publish(mirrored)


def _pose(message: Any) -> tuple[str, FloatArray, FloatArray]:
    """Frame, position and orientation (w, x, y, z) of a ``PoseStamped``."""
    p, q = message.pose.position, message.pose.orientation
    return message.header.frame_id, np.array((p.x, p.y, p.z)), np.array((q.w, q.x, q.y, q.z))


class _HandGoals:
    """Cartesian goals of the hands, executed by the Motion Manager. A goal ends the trajectory of its arm."""

    def __init__(
        self, ros: Node, node: bifrost.Node, frames: Mapping[str, str], rejections: RejectionPublisher
    ) -> None:
        self._frames, self._rejections, self._origin = frames, rejections, node.name
        self._goal = HAND_GOAL_TOPIC.publisher(node)
        self.subscriber = HAND_GOAL_STATUS.subscriber(node, queue=STATUS_QUEUE)  # to statuses
        topics = map(GOAL_STATUS.format, HANDS)
        self._publishers = [MirrorPublisher(ros, RosHandGoalStatus, topic, LATCHED) for topic in topics]
        self._active: set[int] = set()  # hands with a forwarded goal that was not canceled
        self._latest: list[bifrost.Received[HandGoalStatus] | None] = [None] * len(HANDS)

    def commands(self) -> Iterator[tuple[type, str, Callable[[Any], Command]]]:
        """Type and name of each topic to subscribe to, and the command made of its messages."""
        for hand, name in enumerate(HANDS):
            yield PoseStamped, GOAL_POSE.format(name), partial(self._start, hand)
            yield Empty, GOAL_CANCEL.format(name), partial(self._cancel, hand)

    def publish(self, silent: str) -> None:
        """Publish new statuses, and the end of goals if a process is ``silent`` (its name, else empty)."""
        for status in self.subscriber.drain(MAX_STATUSES):
            if 0 <= status.message.hand < len(HANDS):
                self._publish(status)
        for latest in self._latest:
            if silent and latest and latest.message.state != IDLE:
                over = HandGoalStatus(latest.message.time, latest.message.hand, IDLE, f"{silent} is silent", 0.0, 0.0)
                self._publish(bifrost.Received(over, 0, latest.sequence, self._origin))

    def cancel_all(self, hw: ValorEscherHWInterface) -> None:
        """Cancel all goals, also those that the Motion System has not reported yet."""
        controllers = (hw.motion.left_arm, hw.motion.right_arm) if hw.motion else ()
        reported = {hand for hand, controller in enumerate(controllers) if controller == HAND_GOAL}
        for hand in sorted(reported | self._active):
            self._cancel(hand, None)(hw)

    def _publish(self, status: bifrost.Received[HandGoalStatus]) -> None:
        self._latest[status.message.hand] = status
        self._publishers[status.message.hand].publish(status)

    def _start(self, hand: int, message: Any) -> Command:
        frame, position, orientation = _pose(message)

        def forward(hw: ValorEscherHWInterface) -> None:
            known = self._frames.get(frame)
            if known is None:
                reason = f"frame {frame[:64]!r}; expected one of {', '.join(self._frames)}"
                self._rejections.reject(GOAL_POSE.format(HANDS[hand]), reason)
            else:
                self._goal.publish(HandGoal(hw.time, hand, True, known, position, orientation))
                self._active.add(hand)

        return forward

    def _cancel(self, hand: int, _: Any) -> Command:
        nothing = np.zeros(0)

        def forward(hw: ValorEscherHWInterface) -> None:
            self._goal.publish(HandGoal(hw.time, hand, False, "", nothing, nothing))
            self._active.discard(hand)

        return forward
