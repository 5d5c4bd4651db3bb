"""Executes commands received through the link and answers with results; reports plans and hand goals of any client."""

import logging
import math
import time
from functools import partial
from typing import Any

from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Empty
from valor_msgs.msg import Rejection

from valor.link.classes import MessageClass
from valor.link.endpoint import Arrived, LinkEndpoint
from valor.link.errors import SealError
from valor.link_robot.observer import Observer
from valor.robot.description import RobotDescription
from valor.ros import packed_steps, progress
from valor.ros.limbs import HANDS
from valor.ros.link_messages import ACTIONS, COMMANDS, MODE, LinkMessageType, MessageCodec, pack_message, unpack_message

LATEST = QoSProfile(depth=1)  # volatile: a subscriber that joins later receives no old command
PERIOD = 0.1  # of checks [s]
HAND_PERIOD = 1.0  # between two reports of a hand's error [s]
HAND_STEP = 0.005  # smallest change of the error that is reported [m]
_log = logging.getLogger("link_robot")


class CommandExecutor:
    """Publisher and action client for received commands. For the thread that spins the node."""

    def __init__(self, node: Node, end: LinkEndpoint, robot: RobotDescription) -> None:
        self._end = end
        self.codec = MessageCodec(robot)
        self._publishers = [node.create_publisher(each.type, each.name, LATEST) for each in COMMANDS]
        self._clients = [ActionClient(node, each.type, each.name) for each in ACTIONS]
        self._goals: dict[int, Any] = {}
        self._canceled: set[int] = set()  # before they were accepted
        self._latest: dict[str, int] = {}  # link id of the latest command executed, by target
        self._session = 0
        self.velocity_published_at = -math.inf  # in this session, monotonic [s]; −inf: never

    def begin_session(self) -> None:
        """Discard the goals of the last session; they continue, but their results are not sent."""
        self._session += 1
        self.velocity_published_at = -math.inf
        self._goals.clear()
        self._canceled.clear()
        self._latest.clear()

    def execute(self, arrived: Arrived) -> None:
        """Execute a command of the operator's end, or reject it."""
        try:
            type_, number, content = unpack_message(arrived.content)
            if arrived.rejection:
                raise SealError(arrived.rejection)
            if type_ is LinkMessageType.CANCEL:
                self._cancel(number)
                return
            target = (COMMANDS if type_ is LinkMessageType.TOPIC else ACTIONS)[number].target
            if arrived.kind is MessageClass.COMMAND:
                self._require_latest(arrived.id, target)
            if type_ is LinkMessageType.GOAL:
                self._send_goal(arrived.id, number, content)
            elif type_ is LinkMessageType.TOPIC:
                self._publish(number, content)
                if arrived.kind is MessageClass.STREAM:
                    self.velocity_published_at = time.monotonic()
                else:
                    self._answer(LinkMessageType.ACCEPTED, arrived.id)
            self._latest[target] = arrived.id
        except (SealError, IndexError) as error:
            _log.warning("%s %d of the operator's end rejected: %s", arrived.kind.name, arrived.id, error)
            self._answer(LinkMessageType.REFUSED, arrived.id, str(error).encode())

    def _require_latest(self, number: int, target: str) -> None:
        """Raise SealError for a command that was sent before one executed for its target, or is canceled."""
        latest = max(self._latest.get(target, 0), self._latest.get(MODE, 0))
        if number < latest:
            raise SealError(f"superseded by command {latest}, which was sent after it")
        if number in self._canceled:
            raise SealError("canceled")

    def _answer(self, type_: LinkMessageType, number: int, content: bytes = b"") -> None:
        try:
            self._end.send(MessageClass.ANSWER, pack_message(type_, number, content), time.monotonic())
        except SealError as error:
            _log.warning("no answer to command %d: %s", number, error)

    def report(self, rejection: Rejection) -> None:
        """Send a rejection by the robot, of any client's command."""
        try:
            content = pack_message(LinkMessageType.REJECTION, 0, self.codec.pack(rejection))
            self._end.send(MessageClass.EVENT, content, time.monotonic())
        except SealError:
            _log.info("rejection on %s not sent: no session", rejection.topic)

    def number_of(self, goal_id: Any) -> int:
        """Link id of a goal; 0 if another client sent it."""
        wanted = bytes(goal_id.uuid)
        return next((number for number, each in self._goals.items() if bytes(each.goal_id.uuid) == wanted), 0)

    def soft_stop(self) -> None:
        """Publish a soft stop."""
        self._publishers[0].publish(Empty())

    def _publish(self, index: int, content: bytes) -> None:
        command = COMMANDS[index]
        self._publishers[index].publish(self.codec.unpack(content, command.type))

    def _send_goal(self, number: int, index: int, content: bytes) -> None:
        action, client = ACTIONS[index], self._clients[index]
        goal = self.codec.unpack(content, action.type.Goal)
        if not client.server_is_ready():
            raise SealError(f"no action server of {action.name}")
        client.send_goal_async(goal).add_done_callback(partial(self._accepted, self._session, number))

    def _accepted(self, session: int, number: int, future: Any) -> None:
        handle = future.result()
        if session != self._session:
            return
        if not handle.accepted:
            self._answer(LinkMessageType.REFUSED, number, b"not accepted")
            return
        self._goals[number] = handle
        self._answer(LinkMessageType.ACCEPTED, number)
        handle.get_result_async().add_done_callback(partial(self._ended, session, number))
        if number in self._canceled:
            handle.cancel_goal_async()

    def _ended(self, session: int, number: int, future: Any) -> None:
        if session != self._session:
            return
        self._goals.pop(number, None)
        response = future.result()
        self._answer(LinkMessageType.RESULT, number, bytes((response.status,)) + self.codec.pack(response.result))

    def _cancel(self, number: int) -> None:
        if (handle := self._goals.get(number)) is not None:
            handle.cancel_goal_async()
        else:
            self._canceled.add(number)


class Reporter:
    """Sends changes only; a newer report replaces an older one that was not acknowledged."""

    def __init__(self, end: LinkEndpoint, observer: Observer, executor: CommandExecutor) -> None:
        """``observer``: must be updated by the caller; ``executor``: identifies the goals of the operator."""
        self._end, self._observer, self._executor = end, observer, executor
        self._due = 0.0
        self._packed: tuple[Any, bytes] = (None, b"")  # steps of the plan, and packed: packing is not deterministic
        self.begin_session()

    def begin_session(self) -> None:
        """Report everything again."""
        self._sent: dict[str, int] = {}  # id of the last message by subject
        self._reported: dict[str, Any] = {}
        self._hands: dict[str, tuple[Any, float, float]] = {}  # state and reason, error [m], time [s]

    def turn(self, now: float) -> None:
        """Send due reports; ``now``: monotonic [s]."""
        if now < self._due or not self._end.session.established:
            return
        self._due = now + PERIOD
        try:
            self._report_plan(now)
            if (status := self._observer.latest("controllers")) is not self._reported.get("controllers"):
                content = pack_message(LinkMessageType.CONTROLLERS, 0, self._executor.codec.pack(status))
                self._send("controllers", content, status, now)
            for index, hand in enumerate(HANDS):
                self._report_hand(index, hand, now)
        except SealError:  # too many messages wait; sent in a later turn
            return

    def _report_plan(self, now: float) -> None:
        message = self._observer.latest("steps")
        if message is None:
            return
        plan = message.feedback.feedback.steps
        if plan != self._packed[0]:
            self._packed = (plan, packed_steps.pack(plan) or b"")
        steps = self._packed[1]
        if steps and self._reported.get("steps") != steps:
            self._send("steps", pack_message(LinkMessageType.STEPS, 0, steps), steps, now)
        number = self._executor.number_of(message.goal_id)
        content = progress.pack_feedback(message, steps)
        timeless = content[: progress.STAMP.start] + content[progress.STAMP.stop :]
        if self._reported.get("progress") != (number, timeless):
            self._send("progress", pack_message(LinkMessageType.PROGRESS, number, content), (number, timeless), now)

    def _report_hand(self, index: int, hand: str, now: float) -> None:
        status = self._observer.latest(hand)
        if status is None:
            return
        state, error = (status.state, status.reason), status.position_error
        reported, before, when = self._hands.get(hand, (None, 0.0, 0.0))
        if state != reported or (now - when > HAND_PERIOD and abs(error - before) > HAND_STEP):
            self._send(hand, pack_message(LinkMessageType.HAND, index, progress.pack_hand(status)), state, now)
            self._hands[hand] = (state, error, now)

    def _send(self, subject: str, content: bytes, reported: Any, now: float) -> None:
        self._sent[subject] = self._end.replace(MessageClass.PROGRESS, content, now, self._sent.get(subject, 0))
        self._reported[subject] = reported
