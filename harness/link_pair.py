"""Both ends of the link over an emulated one, in simulated time; the robot's clock is another, and drifts."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import zmq

from harness.emulated_channel import Bandwidth, Conditions, EmulatedChannel, Windows
from valor.common.instance import LINK_RATE
from valor.link.classes import MessageClass
from valor.link.endpoint import Arrived, Channel, Event, LinkEndpoint, MessagesExpired
from valor.link.endpoints import OperatorEndpoint, RobotEndpoint
from valor.link.fields import Layout
from valor.link.picture import Picture
from valor.link.session import Session, shared_secret
from valor.link.state import RobotState

STEP = 0.02  # [s]
APART, DRIFT = 1000.0, 50e-6  # of the robot's clock


def secrets_of_both() -> tuple[bytes, bytes]:
    """As each end derives it from its own secret key and the other's public one."""
    (public, secret), (other_public, other_secret) = zmq.curve_keypair(), zmq.curve_keypair()
    return shared_secret(secret, other_public), shared_secret(other_secret, public)


@dataclass
class Pair:
    """Steps both ends. Times are the operator's [s].

    Attributes:
        executed: what the robot's end was given to obey: when, kind, content.
        refused: what it was not to obey, and why.
        answers: what the operator's end heard.
        execute: obeys instead, and answers.
        given_up: ids of commands that were not acknowledged in time.
    """

    layout: Layout
    observe: Callable[[], RobotState | None]
    slow: Conditions
    fast: Conditions | None = None
    seed: int = 0
    windows: Windows = ()
    picture: Picture | None = None
    cuts: Windows = ()
    rate: float = LINK_RATE
    execute: Callable[[Arrived], None] | None = None
    now: float = 0.0
    executed: list[tuple[float, MessageClass, bytes]] = field(default_factory=list)
    refused: list[tuple[float, MessageClass, bytes, str]] = field(default_factory=list)
    answers: list[bytes] = field(default_factory=list)
    given_up: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        self._secrets = secrets_of_both()
        there = _complement(self.cuts)
        shared = Bandwidth(self.slow)
        self.lines: dict[tuple[bool, Channel], EmulatedChannel] = {}
        for robot in (True, False):
            self.lines[robot, Channel.SLOW] = EmulatedChannel(self.slow, 2 * self.seed + robot, there, shared)
            if self.fast is not None:
                self.lines[robot, Channel.FAST] = EmulatedChannel(self.fast, 2 * self.seed + robot + 7919, self.windows)
        self._flying: list[tuple[float, int, bool, Channel, bytes]] = []
        self._order = itertools.count()
        self.begin_robot()
        self.begin_operator()

    def begin_robot(self) -> None:
        """The robot's end starts, or starts anew."""
        session = Session(self._secrets[0], True, b"same-rob")
        self.robot = RobotEndpoint(session, self.layout, self.observe, self.robot_time, fast=self.fast is not None,
                              picture=lambda: self.picture, rate=self.rate)  # fmt: skip

    def begin_operator(self) -> None:
        """The operator's end starts, or starts anew."""
        session = Session(self._secrets[1], False, b"same-rob")
        self.operator = OperatorEndpoint(session, self.layout, self.now, self.fast is not None, rate=self.rate)

    @property
    def robot_time(self) -> float:
        """What the robot's computer calls now [s]."""
        return APART + (1.0 + DRIFT) * self.now

    def step(self) -> None:
        """20 ms."""
        self.now += STEP
        while self._flying and self._flying[0][0] <= self.now:
            _, _, to_robot, channel, data = heapq.heappop(self._flying)
            end, time = (self.robot, self.robot_time) if to_robot else (self.operator, self.now)
            end.receive(data, channel, time)
        self._turn(self.robot, self.robot_time, True)
        self._turn(self.operator, self.now, False)
        for event in self.robot.events():
            self._obey(event)
        for event in self.operator.events():
            if isinstance(event, Arrived):
                self.answers.append(event.content)
            elif isinstance(event, MessagesExpired):
                self.given_up |= event.ids

    def _turn(self, end: LinkEndpoint, time: float, robot: bool) -> None:
        for channel, data in end.turn(time):
            line = self.lines.get((robot, channel))
            for arrival in line.put(len(data), self.now) if line else ():
                heapq.heappush(self._flying, (arrival, next(self._order), not robot, channel, data))

    def _obey(self, event: Event) -> None:
        if not isinstance(event, Arrived):
            return
        if self.execute is not None:
            self.execute(event)
            return
        if event.rejection:
            self.refused.append((self.now, event.kind, event.content, event.rejection))
            return
        self.executed.append((self.now, event.kind, event.content))
        if event.kind is not MessageClass.STREAM:
            self.robot.send(MessageClass.ANSWER, event.content, self.robot_time)

    def run(self, duration: float) -> None:
        """So long [s]."""
        for _ in range(round(duration / STEP)):
            self.step()

    def until(self, condition: Callable[[], object], longest: float) -> None:
        """Until something is so; fails if it does not become so."""
        end = self.now + longest
        while not condition():
            assert self.now < end, f"not within {longest:g} s of simulated time"
            self.step()


def _complement(cuts: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """When there is no cut."""
    edges = [0.0, *(edge for cut in cuts for edge in cut), float("inf")]
    return list(zip(edges[::2], edges[1::2], strict=True))
