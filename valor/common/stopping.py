"""Asking the Motion System to stop, over Bifrost, of everybody in it who may have the robot.

The Motion Manager is asked, and the Comms Manager, which obeys when no Motion Manager does. What counts is nobody's
answer but the Comms Manager's word on what the motors do.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import bifrost
from valor.common.behaviors import EMERGENCY_STOP, REFLEX, Behavior, ControlMode
from valor.common.messages import BehaviorReply, BehaviorRequest
from valor.common.topics import BEHAVIOR, PROPRIOCEPTOR, STOP, ServiceTopic

LONGEST = 3.0  # until it is given up, once somebody has answered [s]
LONGEST_WITHOUT_ANSWER = 10.0  # on a busy computer rclpy takes long to import [s]
LONGEST_TO_FREEZE = 15.0  # a robot that walks is frozen once it stands [s]
LASTING = 0.1  # for which the motors must obey before it is believed: a change of mode may be under way [s]
_ANSWER = 1.0  # until a request is made anew [s]
_PAUSE = 0.05  # between rounds of requests [s]
_LOOK = 0.01  # [s]


@dataclass(frozen=True)
class Goal:
    """Where the robot shall come to rest.

    Attributes:
        reached: what is meant: behaviors, or the balance reflex, which keeps the balance and holds the joints then.
        requests: what the Motion Manager is asked for, each when it has refused the one before; the Comms Manager is
            asked for the first.
        modes: what the VRC is asked for, likewise.
        longest: how long to try [s].
    """

    reached: tuple[str, ...]
    requests: tuple[str, ...]
    modes: tuple[str, ...]
    longest: float


_B = Behavior

HALT = Goal((_B.SOFT_STOP, _B.FREEZE, _B.FALL, REFLEX), (_B.SOFT_STOP, _B.FREEZE, _B.FALL), (EMERGENCY_STOP,), LONGEST)
"""Keep the balance where there is one, else lock the joints; on its way up from the floor only Fall follows."""

LOCK = Goal((_B.FREEZE,), (_B.FREEZE, _B.SOFT_STOP, _B.FALL), (ControlMode.FREEZE, EMERGENCY_STOP), LONGEST_TO_FREEZE)
"""Lock the joints: a robot that walks or steps must come to stand before."""


@dataclass
class Path:
    """One way to the robot.

    Attributes:
        name: whom it leads to, over what.
        answer: what was answered; empty: nothing yet.
        after: when, since the stop was asked for [s]; None: not at all.
    """

    name: str
    answer: str = ""
    after: float | None = None


class _Asked:
    """One process, asked over Bifrost, again and again until it obeys.

    Attributes:
        path: what it has answered.
        client: whose answer is waited for.
        obeys: by its own word.
    """

    def __init__(
        self,
        node: bifrost.Node,
        service: ServiceTopic[BehaviorRequest, BehaviorReply],
        requests: Sequence[str],
        goal: Goal,
        began: float,
    ) -> None:
        """``requests``: what it is asked for, each when it has refused the one before."""
        self.path = Path(f"{service.owner}, over Bifrost")
        self.client = service.client(node)
        self.obeys = False
        self._requests, self._goal, self._began = requests, goal, began
        self._request = -1  # the one that is open; -1: none
        self._next = 0.0  # when the next round begins, monotonic [s]

    def advance(self) -> None:
        """Ask, and take in what was answered."""
        now = time.monotonic()
        if self._request < 0:
            if now >= self._next and not self.obeys:
                self._ask(0)
            return
        try:
            reply = self.client.answer()
        except bifrost.NoServerError:
            self._round_ends(now)
            return
        except bifrost.Error as error:
            self.path.answer = self.path.answer or str(error)
            self._round_ends(now)
            return
        if reply is not None:
            self._take(reply, now)

    def doubt(self, undone: bool, now: float) -> None:
        """The motors do not do what it said; when they have ceased to, or after a while, it is asked anew."""
        self.obeys &= not undone and now < self._next + _ANSWER

    def _ask(self, request: int) -> None:
        self._request = request
        self.client.ask(BehaviorRequest(self._requests[request]), timeout=_ANSWER)

    def _take(self, reply: BehaviorReply, now: float) -> None:
        asked, others = self._requests[self._request], self._requests[self._request + 1 :]
        self.obeys = reply.behavior in self._goal.reached
        if self.obeys or reply.accepted or self.path.after is None:
            self.path.answer = reply.behavior if self.obeys or reply.accepted else f"{asked} refused: {reply.reason}"
            self.path.after = now - self._began
        # To let the robot go is for one that is on its way up, and for nobody who refuses for another reason.
        if self.obeys or reply.accepted or not others or (others[0] == _B.FALL and reply.behavior != _B.GET_UP):
            self._round_ends(now)
        else:
            self._ask(self._request + 1)

    def _round_ends(self, now: float) -> None:
        self._request = -1
        self._next = now + _PAUSE


class MotionSystem:
    """Motion Manager and Comms Manager, asked over Bifrost, and what the latter says of the motors."""

    def __init__(self, node: bifrost.Node, goal: Goal, began: float) -> None:
        """``node`` stays its owner's; ``began``: when the stop was asked for, monotonic [s]."""
        self._goal, self._node = goal, node
        self._states = PROPRIOCEPTOR.subscriber(node)
        self._asked = [
            _Asked(node, BEHAVIOR, goal.requests, goal, began),
            _Asked(node, STOP, goal.requests[:1], goal, began),
        ]
        self._behavior = ""  # of the newest Motor
        self._since: float | None = None  # when the motors began to obey, monotonic [s]
        self._heard = 0.0  # when they were heard of last, monotonic [s]

    def __enter__(self) -> MotionSystem:
        return self

    def __exit__(self, *exception: object) -> None:
        self._states.close()
        for asked in self._asked:
            asked.client.close()

    @property
    def paths(self) -> list[Path]:
        """Both."""
        return [asked.path for asked in self._asked]

    @property
    def obeys(self) -> bool:
        """Whether one of them does, by its own word."""
        return any(asked.obeys for asked in self._asked)

    def wait(self) -> None:
        sources: tuple[Any, ...] = (*(asked.client for asked in self._asked), self._states)
        bifrost.wait(sources, timeout=_LOOK)

    def advance(self) -> None:
        """Ask, and take in what has come."""
        self._look()
        for asked in self._asked:
            asked.advance()

    def _look(self) -> None:
        received = self._states.latest()
        if received is None:
            return
        now = time.monotonic()
        self._heard = now
        self._behavior = received.message.motor_behavior
        if self._behavior in self._goal.reached:
            self._since = self._since or now
            return
        undone, self._since = self._since is not None, None
        for asked in self._asked:
            asked.doubt(undone, now)

    def confirmed(self) -> str:
        """What the robot is known to be in, if that is what is meant."""
        if self._since is None or self._heard - self._since < LASTING:
            return ""
        return "brought to stand by comms_manager" if self._behavior == REFLEX else self._behavior

    def seen(self) -> str:
        """What is known of the motors."""
        if not self._heard:
            silent = "comms_manager is silent: what the motors do is unknown"
            return silent if self._node.discovery.connected else f"{silent}; {self._node.discovery.daemon_silent}"
        return f"the motors obey {self._behavior or 'nobody yet'}"
