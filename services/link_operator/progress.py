"""How plans and hands' goals fare at the robot's, as its own topics tell it, and as feedback of goals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from valor_msgs.msg import HandGoalStatus
from vigir_footstep_planning_msgs.msg import Step

from valor.link.errors import SealError
from valor.ros import packed_steps
from valor.ros.limbs import HANDS
from valor.ros.progress import FEEDBACK, GOAL_STATUS, FeedbackMessage, mark, mark_of, unpack_feedback, unpack_hand

PLANS = 4  # whose steps are kept
WATCHERS = QoSProfile(depth=20, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Progress:
    """Publishes what has come. From one thread."""

    def __init__(self, node: Node, frame: str, tell: Callable[[int, Any], Any]) -> None:
        """Make publishers.

        Args:
            node: in the operator's domain.
            frame: odom, as tf names it.
            tell: hands feedback to the goal of the link's id; returns the goal's id, None: it is none of the link's.
        """
        self._frame, self._tell = frame, tell
        self._feedback = node.create_publisher(FeedbackMessage, FEEDBACK, WATCHERS)
        self._hands = [node.create_publisher(HandGoalStatus, GOAL_STATUS.format(hand), WATCHERS) for hand in HANDS]
        self._steps: dict[int, list[Step]] = {}
        self._newest: tuple[int, bytes] = (0, b"")

    def steps(self, content: bytes) -> None:
        """Of a plan that runs.

        Raises:
            SealError: they are none.
        """
        self._steps[mark(content)] = packed_steps.unpack(content)
        if self._newest[1] and mark_of(self._newest[1]) == mark(content):  # they come behind what names them
            self.plan(*self._newest)
        while len(self._steps) > PLANS:
            del self._steps[next(iter(self._steps))]

    def plan(self, number: int, content: bytes) -> None:
        """How a plan fares; ``number``: the link's id of its goal, 0: it is another's.

        Raises:
            SealError: it is none.
        """
        message = unpack_feedback(content, self._steps, self._frame)
        self._newest = (number, content)
        if (goal_id := self._tell(number, message.feedback)) is not None:
            message.goal_id = goal_id
        self._feedback.publish(message)

    def hand(self, place: int, content: bytes) -> None:
        """How a hand's goal fares.

        Raises:
            SealError: it is none, or of no hand.
        """
        if not 0 <= place < len(HANDS):
            raise SealError(f"hand {place}; expected one of {len(HANDS)}")
        self._hands[place].publish(unpack_hand(content, place))
