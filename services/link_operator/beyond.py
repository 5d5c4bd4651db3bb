"""Verbs of valorctl that this side asks of the robot's: sent once, and what becomes of them, for who asks again."""

from __future__ import annotations

import secrets
import time
from collections import OrderedDict
from dataclasses import dataclass

import bifrost
from valor.common.messages import BeyondReply, BeyondRequest
from valor.common.topics import BEYOND
from valor.link.classes import Kind
from valor.link.end import End
from valor.link.errors import SealError
from valor.link.verbs import pack_verb, read_said
from valor.ros.relayed import Word, worded

KEPT = 32  # verbs
OPEN = ("on its way", "begun")


@dataclass
class _Asked:
    command: int  # the link's id; -1: of a session that is over
    state: str = OPEN[0]
    status: int = 0
    said: str = ""


class Beyond:
    """Over Bifrost, where nobody calls without the instance's keys. From the loop's thread."""

    def __init__(self, node: bifrost.Node, end: End) -> None:
        self._end = end
        self._asked: OrderedDict[int, _Asked] = OrderedDict()
        self._server = BEYOND.server(node, self._handle)

    def turn(self) -> None:
        """Answer those who ask."""
        self._server.serve()

    def _handle(self, request: BeyondRequest, _client: str) -> BeyondReply:
        now = time.monotonic()
        number = request.number
        if request.words:
            number = secrets.randbits(53)  # so that nobody who asked a process before this one is answered
            try:
                command = self._end.send(Kind.COMMAND, worded(Word.VERB, 0, pack_verb(request.words)), now)
                self._asked[number] = _Asked(command)
            except SealError as error:
                self._asked[number] = _Asked(-1, "lost", said=f"not sent: {error}")
            while len(self._asked) > KEPT:
                self._asked.popitem(last=False)
        each = self._asked.get(number) or _Asked(-1, "lost", said="link_operator began anew; nobody knows of it")
        return BeyondReply(number, each.state, each.status, each.said, min(self._end.silent(now), 1e6))

    def _of(self, command: int) -> _Asked | None:
        return next((each for each in self._asked.values() if each.command == command and each.state in OPEN), None)

    def accepted(self, command: int) -> None:
        """The robot's side has begun it."""
        if (each := self._of(command)) is not None:
            each.state = OPEN[1]

    def lost(self, command: int, why: str) -> bool:
        """It was refused there, or given up here; whether it was a verb at all."""
        if (each := self._of(command)) is None:
            return False
        each.state, each.said = "lost", why
        return True

    def ended(self, command: int, content: bytes) -> None:
        """What was said to it.

        Raises:
            SealError: it cannot be read.
        """
        if (each := self._of(command)) is not None:
            each.status, each.said = read_said(content)
            each.state = "ended"

    def lose_all(self, why: str) -> None:
        """A session ended: what becomes of its verbs is not told any more."""
        for each in self._asked.values():
            if each.state in OPEN:
                each.state, each.said = "lost", why
            each.command = -1
