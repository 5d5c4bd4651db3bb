"""The right hand led by Cartesian goals: an ordinary client of its topics, that knows ROS names alone."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.ros.limbs import HANDS
from valor.tasks.plan import REACHED, RESISTED, HandMove, Plan

HAND = HANDS[1]
GOAL, CANCEL, STATUS = (f"flor/{HAND}/goal_{what}" for what in ("pose", "cancel", "status"))
ODOM = "odom"

_TAKEN = 20.0  # from a goal sent to its first word [s]
_AGAIN = 2.0  # after which it is sent once more [s]
_SLOWEST_CLOCK = 0.05  # real-time factor below which a goal is given up


@dataclass(frozen=True)
class Moved:
    """How a goal ended.

    Attributes:
        name: of the move.
        state: of the hand when the next goal came, as HandGoalStatus has it.
        error: of its place, as the robot believes [m].
        time: robot time then [s].
    """

    name: str
    state: str
    error: float
    time: float


def lead(
    instance: Instance,
    plan: Plan,
    check: Callable[[], None],
    tell: Callable[[str], None] = lambda name: None,
) -> list[Moved]:
    """Lead the right hand through goals, one after the other, and let it go.

    Args:
        instance: must be up, in a manipulate mode.
        plan: its goals; one that is not reached is left when its patience is over.
        check: called while waiting; may raise to give up. The arm then stays.
        tell: is told what is done next.

    Raises:
        ValorError: a goal is not taken, or the hand let go; says why. A hand that pressed in vain is led back.
    """
    from std_msgs.msg import Empty

    from valor.valorctl.ros_client import RosClient

    with RosClient(instance, check) as ros:
        hand = _Hand(ros, instance.settings().frame_prefix + ODOM)
        cancel = ros.publisher(Empty, CANCEL, 1)
        made = list[Moved]()
        try:
            free = plan.moves[0]
            for move in plan.moves:
                tell(move.name)
                made.append(hand.go(move))
                free = move if made[-1].state == REACHED else free
                if made[-1].state == RESISTED:
                    reason, kept = hand.reason, False
                    for retreat in plan.retreat(free):
                        tell(retreat.name)
                        kept = hand.go(retreat).state == RESISTED
                    where = "did not come free" if kept else "is back"
                    raise ValorError(f"{move.name}: {plan.resisted}: the hand was let go: {reason}; it {where}")
        finally:
            cancel.publish(Empty())
        return made


class _Hand:
    """The right hand, as its topics show it."""

    def __init__(self, ros: Any, frame: str) -> None:
        from geometry_msgs.msg import PoseStamped
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from valor_msgs.msg import HandGoalStatus

        self._ros, self._frame, self._pose = ros, frame, PoseStamped
        self._newest: Any = None
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        ros.subscribe(HandGoalStatus, STATUS, self._hear, latched)
        self._goal = ros.publisher(PoseStamped, GOAL, 1)

    def go(self, move: HandMove) -> Moved:
        """Until the goal is reached or cannot be, or its patience is over."""
        message = self._pose()
        message.header.frame_id = self._frame
        p, q = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = move.hand.position
        q.w, q.x, q.y, q.z = move.hand.orientation
        self._newest = None
        self._send(message, f"{move.name}: the goal of {HAND} is not taken")
        began = self._newest.time

        def over() -> bool:
            return self._state != "moving" or self._newest.time - began > 1e9 * move.patience

        self._ros.wait(over, _TAKEN + move.patience / _SLOWEST_CLOCK, f"{move.name}: {HAND} is still on its way")
        newest = self._newest
        if newest.state == "idle":
            raise ValorError(f"{move.name}: {HAND} was let go: {newest.reason}")
        return Moved(move.name, str(newest.state), float(newest.position_error), 1e-9 * newest.time)

    def _send(self, message: Any, complaint: str) -> None:
        """Until it is taken: a listener that has been found may not yet listen."""
        sent = -math.inf

        def taken() -> bool:
            nonlocal sent
            if self._state != "moving" and time.monotonic() - sent > _AGAIN:
                self._goal.publish(message)
                sent = time.monotonic()
            return self._state == "moving"

        self._ros.wait(taken, _TAKEN, complaint)

    @property
    def reason(self) -> str:
        """Of its state."""
        return str(self._newest.reason)

    @property
    def _state(self) -> str:
        return "" if self._newest is None else str(self._newest.state)

    def _hear(self, message: Any) -> None:
        self._newest = message
