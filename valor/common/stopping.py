"""Stop requests over Bifrost: to the Motion Manager, and to the Comms Manager, which stops without one.

The Comms Manager's report of the motors' behavior confirms a stop, not the replies.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import bifrost
from valor.common.behaviors import EMERGENCY_STOP, REFLEX, Behavior, ControlMode
from valor.common.messages import BehaviorReply, BehaviorRequest
from valor.common.topics import BEHAVIOR, PROPRIOCEPTOR, STOP, ServiceTopic

LONGEST = 3.0  # timeout once a process has replied [s]
LONGEST_WITHOUT_ANSWER = 10.0  # timeout without a reply: on a busy computer rclpy takes long to import [s]
LONGEST_TO_FREEZE = 15.0  # timeout of a freeze: a walking robot must come to stand first [s]
LASTING = 0.1  # time that the motors must follow before the stop is confirmed [s]
_REPLY = 1.0  # timeout of one request; it is then repeated [s]
_PAUSE = 0.05  # between rounds of requests [s]
_POLL = 0.01  # [s]


@dataclass(frozen=True)
class StopGoal:
    """Behavior in which the robot must come to rest."""

    reached: tuple[str, ...]  # behaviors that fulfil the goal
    # Behaviors to request, each after rejection of the previous one; the Comms Manager receives the first only.
    requests: tuple[str, ...]
    modes: tuple[str, ...]  # control modes to request from the VRC, in the same way
    longest: float  # timeout [s]


_B = Behavior

HALT = StopGoal(
    (_B.SOFT_STOP, _B.FREEZE, _B.FALL, REFLEX), (_B.SOFT_STOP, _B.FREEZE, _B.FALL), (EMERGENCY_STOP,), LONGEST
)
"""Keep balance if possible, else lock the joints; while getting up from the floor only Fall is accepted."""

LOCK = StopGoal(
    (_B.FREEZE,), (_B.FREEZE, _B.SOFT_STOP, _B.FALL), (ControlMode.FREEZE, EMERGENCY_STOP), LONGEST_TO_FREEZE
)
"""Lock the joints; a walking or stepping robot comes to stand first."""


@dataclass
class StopRoute:
    """Route of a stop request to the robot."""

    name: str  # receiver and transport
    answer: str = ""  # its reply; empty: none yet
    after: float | None = None  # time from the stop request to the reply [s]; None: no reply


class _Requester:
    """Requests to one process over Bifrost, repeated until ``obeys``: until its reply reports compliance."""

    def __init__(
        self,
        node: bifrost.Node,
        service: ServiceTopic[BehaviorRequest, BehaviorReply],
        requests: Sequence[str],
        goal: StopGoal,
        began: float,
    ) -> None:
        self.route = StopRoute(f"{service.owner}, over Bifrost")
        self.client = service.client(node)
        self.obeys = False
        self._requests, self._goal, self._began = requests, goal, began
        self._request = -1  # index of the open request; -1: none
        self._next = 0.0  # start of the next round, monotonic [s]

    def advance(self) -> None:
        """Send a request if none is open, and process the reply."""
        now = time.monotonic()
        if self._request < 0:
            if now >= self._next and not self.obeys:
                self._send(0)
            return
        try:
            reply = self.client.answer()
        except bifrost.Error as error:
            if not isinstance(error, bifrost.NoServerError):
                self.route.answer = self.route.answer or str(error)
            self._end_round(now)
            return
        if reply is not None:
            self._process(reply, now)

    def doubt(self, undone: bool, now: float) -> None:
        """Repeat the request if the motors contradict the reply: if they have left the behavior, or after a while."""
        self.obeys &= not undone and now < self._next + _REPLY

    def _send(self, request: int) -> None:
        self._request = request
        self.client.ask(BehaviorRequest(self._requests[request]), timeout=_REPLY)

    def _process(self, reply: BehaviorReply, now: float) -> None:
        requested, others = self._requests[self._request], self._requests[self._request + 1 :]
        self.obeys = reply.behavior in self._goal.reached
        if self.obeys or reply.accepted or self.route.after is None:
            accepted = self.obeys or reply.accepted
            self.route.answer = reply.behavior if accepted else f"{requested} rejected: {reply.reason}"
            self.route.after = now - self._began
        # Fall makes the robot limp: request it only while the robot gets up, and not after other rejections.
        if self.obeys or reply.accepted or not others or (others[0] == _B.FALL and reply.behavior != _B.GET_UP):
            self._end_round(now)
        else:
            self._send(self._request + 1)

    def _end_round(self, now: float) -> None:
        self._request = -1
        self._next = now + _PAUSE


class MotionSystem:
    """Stop requests to Motion Manager and Comms Manager, and the motors' behavior as the latter reports it."""

    def __init__(self, node: bifrost.Node, goal: StopGoal, began: float) -> None:
        """``node`` remains open; ``began``: time of the stop request, monotonic [s]."""
        self._goal, self._node = goal, node
        self._states = PROPRIOCEPTOR.subscriber(node)
        self._requesters = [
            _Requester(node, BEHAVIOR, goal.requests, goal, began),
            _Requester(node, STOP, goal.requests[:1], goal, began),
        ]
        self._behavior = ""  # of the latest Motor
        self._since: float | None = None  # start of the goal's behavior, monotonic [s]
        self._received = 0.0  # time of the latest report, monotonic [s]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._states.close()
        for requester in self._requesters:
            requester.client.close()

    @property
    def paths(self) -> list[StopRoute]:
        """Both routes."""
        return [requester.route for requester in self._requesters]

    @property
    def obeys(self) -> bool:
        """True if a reply reports compliance."""
        return any(requester.obeys for requester in self._requesters)

    def wait(self) -> None:
        """Wait for a reply or report, at most 10 ms."""
        sources: tuple[Any, ...] = (*(requester.client for requester in self._requesters), self._states)
        bifrost.wait(sources, timeout=_POLL)

    def advance(self) -> None:
        """Process reports and replies, and send requests that are due."""
        self._process_report()
        for requester in self._requesters:
            requester.advance()

    def _process_report(self) -> None:
        received = self._states.latest()
        if received is None:
            return
        now = time.monotonic()
        self._received = now
        self._behavior = received.message.motor_behavior
        if self._behavior in self._goal.reached:
            self._since = self._since or now
            return
        undone, self._since = self._since is not None, None
        for requester in self._requesters:
            requester.doubt(undone, now)

    def confirmed(self) -> str:
        """The robot's behavior once it fulfils the goal; empty: not yet."""
        if self._since is None or self._received - self._since < LASTING:
            return ""
        return "brought to stand by comms_manager" if self._behavior == REFLEX else self._behavior

    def seen(self) -> str:
        """Latest report of the motors' behavior, for the user."""
        if not self._received:
            silent = "comms_manager does not publish: the motors' behavior is unknown"
            return silent if self._node.discovery.connected else f"{silent}; {self._node.discovery.daemon_silent}"
        return f"the motors follow {self._behavior or 'no behavior yet'}"
