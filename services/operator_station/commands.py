"""Every command that the operator gave: its number, how old it was, and what became of it. None is given twice."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import count

from valor.common.errors import RefusalError

KEPT = 30


@dataclass
class Command:
    """One.

    Attributes:
        sequence: its number since the station started.
        text: what was asked for.
        by: the operator's name.
        age: at most so old when it came [s].
        given: when it came, monotonic [s].
        state: ``sent``, ``acknowledged``, ``done`` or ``refused``.
        answer: in the words of who answered.
    """

    sequence: int
    text: str
    by: str
    age: float
    given: float
    state: str = "sent"
    answer: str = ""

    def line(self) -> str:
        """For people."""
        return f"#{self.sequence} {self.text}: {self.state}" + (f" – {self.answer}" if self.answer else "")


class CommandLog:
    """The newest commands, the newest first."""

    def __init__(self) -> None:
        self._sequence = count(1)
        self.commands: deque[Command] = deque(maxlen=KEPT)

    def begin(self, text: str, by: str, age: float, now: float, oldest: float) -> Command:
        """Note a command that is about to be given.

        Args:
            text: what is asked for.
            by: the operator's name.
            age: how old it is at most [s].
            now: monotonic [s].
            oldest: it may be [s].

        Raises:
            RefusalError: it came too late; it is noted as refused, and must not be given.
        """
        command = Command(next(self._sequence), text, by, age, now)
        self.commands.appendleft(command)
        if age > oldest:
            command.state = "refused"
            command.answer = f"came too late: made up to {age:.1f} s ago; expected at most {oldest:g} s"
            raise RefusalError("age", command.line())
        return command
