"""Does what has come in time, and says what became of it."""

from __future__ import annotations

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

from valor.link.classes import Kind
from valor.link.end import Arrived, End
from valor.link.errors import SealError
from valor.link_robot.verbs import Verbs
from valor.robot.description import RobotDescription
from valor.ros.relayed import ACTIONS, COMMANDS, Deflated, Word, read, worded

NEWEST = QoSProfile(depth=1)  # volatile: who comes later is told nothing of what was said before
_log = logging.getLogger("link_robot")


class Obedience:
    """Publishes and sends goals, from the thread that spins the node: nothing waits between link and ROS.

    Attributes:
        streamed: when the newest velocity of this session was published, monotonic [s]; −inf: none was.
    """

    def __init__(self, node: Node, end: End, robot: RobotDescription) -> None:
        self._end, self._verbs = end, Verbs(end)
        self._deflated = Deflated(robot)
        self._publishers = [node.create_publisher(each.type, each.name, NEWEST) for each in COMMANDS]
        self._clients = [ActionClient(node, each.type, each.name) for each in ACTIONS]
        self._goals: dict[int, Any] = {}
        self._canceled: set[int] = set()  # before they were accepted
        self._session = 0
        self.streamed = -math.inf

    def turn(self, now: float) -> None:
        """Say what has ended; ``now``: monotonic [s]."""
        self._verbs.turn(now)

    def begin(self) -> None:
        """Another session: goals that run go on, but nobody asks for what becomes of them."""
        self._session += 1
        self.streamed = -math.inf
        self._goals.clear()
        self._canceled.clear()

    def obey(self, arrived: Arrived) -> None:
        """What the operator's end has sent."""
        try:
            word, number, content = read(arrived.content)
            if arrived.refused:
                _log.warning("%s %d not obeyed: %s", word.name.lower(), arrived.id, arrived.refused)
                self._answer(Word.REFUSED, arrived.id, arrived.refused.encode())
            elif word is Word.TOPIC:
                self._publish(number, content)
                if arrived.kind is Kind.STREAM:
                    self.streamed = time.monotonic()
                else:
                    self._answer(Word.ACCEPTED, arrived.id)
            elif word is Word.GOAL:
                self._begin(arrived.id, number, content)
            elif word is Word.CANCEL:
                self._cancel(number)
            elif word is Word.VERB:
                self._verbs.begin(arrived.id, content)
                self._answer(Word.ACCEPTED, arrived.id)
        except (SealError, IndexError) as error:
            _log.warning("%s of the operator's end: %s", arrived.kind.name, error)
            self._answer(Word.REFUSED, arrived.id, str(error).encode())

    def _answer(self, word: Word, number: int, content: bytes = b"") -> None:
        try:
            self._end.send(Kind.ANSWER, worded(word, number, content), time.monotonic())
        except SealError as error:
            _log.warning("no answer to %d: %s", number, error)

    def tell(self, rejection: Rejection) -> None:
        """What the robot refused, whoever asked for it."""
        try:
            content = worded(Word.TOLD, 0, self._deflated.pack(rejection))
            self._end.send(Kind.EVENT, content, time.monotonic())
        except SealError:
            _log.info("nobody hears of the refusal on %s", rejection.topic)

    def number_of(self, goal_id: Any) -> int:
        """The link's id of a goal that it sent; 0: it is another's."""
        known = bytes(goal_id.uuid)
        return next((number for number, each in self._goals.items() if bytes(each.goal_id.uuid) == known), 0)

    def stop_softly(self) -> None:
        """As the operator's soft stop."""
        self._publishers[0].publish(Empty())

    def _publish(self, place: int, content: bytes) -> None:
        command = COMMANDS[place]
        self._publishers[place].publish(self._deflated.unpack(content, command.type))

    def _begin(self, number: int, place: int, content: bytes) -> None:
        action, client = ACTIONS[place], self._clients[place]
        goal = self._deflated.unpack(content, action.type.Goal)
        if not client.server_is_ready():
            self._answer(Word.REFUSED, number, f"nobody serves {action.name} now".encode())
            return
        client.send_goal_async(goal).add_done_callback(partial(self._accepted, self._session, number))

    def _accepted(self, session: int, number: int, future: Any) -> None:
        handle = future.result()
        if session != self._session:
            return
        if not handle.accepted:
            self._answer(Word.REFUSED, number, b"not accepted")
            return
        self._goals[number] = handle
        self._answer(Word.ACCEPTED, number)
        handle.get_result_async().add_done_callback(partial(self._ended, session, number))
        if number in self._canceled:
            handle.cancel_goal_async()

    def _ended(self, session: int, number: int, future: Any) -> None:
        if session != self._session:
            return
        self._goals.pop(number, None)
        told = future.result()
        self._answer(Word.RESULT, number, bytes((told.status,)) + self._deflated.pack(told.result))

    def _cancel(self, number: int) -> None:
        if (handle := self._goals.get(number)) is not None:
            handle.cancel_goal_async()
        else:
            self._canceled.add(number)
