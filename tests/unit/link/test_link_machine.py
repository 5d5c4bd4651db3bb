"""Both ends over a network that loses, reorders, duplicates and replays anything, while either end restarts."""

from __future__ import annotations

from typing import Any

import pytest
from cryptography.hazmat.primitives.ciphers.aead import AESCCM
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from harness.examples import examples
from harness.link_pair import APART, secrets_of_both
from harness.places import ROBOTS
from valor.link import session
from valor.link.classes import MessageClass
from valor.link.endpoint import Arrived, Channel, LinkEndpoint
from valor.link.endpoints import OperatorEndpoint, RobotEndpoint
from valor.link.errors import SealError
from valor.link.fields import Layout
from valor.link.session import Session
from valor.robot.description import RobotDescription

LAYOUT = Layout(RobotDescription.load(ROBOTS / "escher"))
SECRETS = secrets_of_both()
TURN = 0.1  # of both ends, and delay of a datagram on the healed network [s]
HEALING = 80  # turns after which a command must be executed
HISTORY = 100  # datagrams replayed at once
HELLOS = 6  # of the operator's end in that time


class Machine(RuleBasedStateMachine):
    """The network and both ends; every datagram ever sent can be replayed to either end."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.flying: list[tuple[bool, bytes]] = []  # to the robot's end?
        self.recorded: list[tuple[bool, bytes]] = []
        self.sent: dict[bytes, tuple[int, MessageClass]] = {}
        self.obeyed: list[bytes] = []
        self.stopped = -1  # number of the latest stop that was obeyed
        self.used: set[tuple[bytes, bytes]] = set()
        self.patch = pytest.MonkeyPatch()
        self.patch.setattr(session, "AESCCM", self._cipher)

    def _cipher(self, key: bytes, tag: int) -> Any:
        """A cipher that reports a nonce used twice."""
        cipher, used = AESCCM(key, tag), self.used

        class Reporting:
            decrypt = staticmethod(cipher.decrypt)

            @staticmethod
            def encrypt(nonce: bytes, data: bytes, header: bytes) -> bytes:
                assert (key, nonce) not in used, "a nonce is used twice"
                used.add((key, nonce))
                return cipher.encrypt(nonce, data, header)

        return Reporting

    @initialize()
    def start(self) -> None:
        self.restart(True)
        self.restart(False)

    @rule(robot=st.booleans())
    def restart(self, robot: bool) -> None:
        made = Session(SECRETS[not robot], robot, b"same-rob")
        if robot:
            self.robot = RobotEndpoint(made, LAYOUT, lambda: None, APART + self.now)
        else:
            self.operator = OperatorEndpoint(made, LAYOUT, self.now)

    def end(self, robot: bool) -> tuple[LinkEndpoint, float]:
        """One end, and its time [s]."""
        return (self.robot, APART + self.now) if robot else (self.operator, self.now)

    @rule(seconds=st.sampled_from((0.02, 0.3, 1.0, 2.5)))
    def turn(self, seconds: float) -> None:
        self.now += seconds
        for robot in (True, False):
            end, now = self.end(robot)
            made = [(not robot, data) for _, data in end.turn(now)]
            self.flying += made
            self.recorded += made

    def receive(self, to_robot: bool, data: bytes) -> None:
        end, now = self.end(to_robot)
        end.receive(data, Channel.SLOW, now)
        for event in end.events():
            if to_robot and isinstance(event, Arrived) and not event.rejection:
                self.obey(event.content)

    def obey(self, content: bytes) -> None:
        number, kind = self.sent[content]
        assert content not in self.obeyed, f"{content!r} is obeyed twice"
        assert number > self.stopped or kind is MessageClass.STOP, f"{content!r} is obeyed after a later stop"
        self.obeyed.append(content)
        if kind is MessageClass.STOP:
            self.stopped = max(self.stopped, number)

    @precondition(lambda self: self.flying)
    @rule(which=st.integers(0, 2**16), copies=st.integers(0, 2), keep=st.booleans())
    def deliver(self, which: int, copies: int, keep: bool) -> None:
        """Reorder, lose, duplicate, or delay a duplicate."""
        each = self.flying[which % len(self.flying)]
        if not keep:
            self.flying.remove(each)
        for _ in range(copies):
            self.receive(*each)

    @rule()
    def lose_all(self) -> None:
        self.flying.clear()

    @precondition(lambda self: self.recorded)
    @rule(which=st.integers(0, 2**16), whom=st.booleans(), several=st.integers(1, 8))
    def replay(self, which: int, whom: bool, several: int) -> None:
        first = which % len(self.recorded)
        for _, data in self.recorded[first : first + several]:
            self.receive(whom, data)

    @rule()
    def replay_everything(self) -> None:
        for number, (to_robot, data) in enumerate(self.recorded[:HISTORY]):
            self.receive(to_robot, data)
            if number % 4 == 0:
                self.turn(0.0)

    @rule(turns=st.sampled_from((1, 8, 30)))
    def work(self, turns: int) -> None:
        for _ in range(turns):
            arriving, self.flying = self.flying, []
            for each in arriving:
                self.receive(*each)
            self.turn(TURN)

    @rule(
        kind=st.sampled_from((MessageClass.STOP, MessageClass.COMMAND, MessageClass.STREAM)), size=st.integers(0, 130)
    )
    def operate(self, kind: MessageClass, size: int) -> None:
        self.send(kind, size)

    def send(self, kind: MessageClass, size: int = 0) -> bytes:
        """Content of a message that was sent; empty without a session."""
        content = f"{len(self.sent)} ".encode().ljust(size, b".")
        try:
            (self.operator.stream if kind is MessageClass.STREAM else self.operator.send)(kind, content, self.now)
        except SealError:
            return b""
        self.sent[content] = (len(self.sent), kind)
        return content

    def teardown(self) -> None:
        """The network is healed: within a bounded number of exchanges a command is executed."""
        if hasattr(self, "operator"):
            self.work(1)
            before, content, number = self.operator.meter.total["hello"], b"", -1
            for _ in range(HEALING):
                self.work(1)
                if content in self.obeyed:
                    break
                if not content or self.operator.session.number != number:
                    content, number = self.send(MessageClass.COMMAND), self.operator.session.number
            assert content in self.obeyed, "the ends are not connected again"
            assert self.operator.meter.total["hello"] - before <= HELLOS * 100
        self.patch.undo()


TestLinkMachine = Machine.TestCase
TestLinkMachine.settings = settings(examples(60), stateful_step_count=40)
