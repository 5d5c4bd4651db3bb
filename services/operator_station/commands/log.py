"""Log of the operator's commands, with their results."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import count

from valor.common.errors import RefusalError

KEPT = 30


@dataclass
class Command:
    """Command of an operator, sent once."""

    sequence: int
    text: str
    by: str
    state: str = "sent"
    answer: str = ""

    def line(self) -> str:
        return f"#{self.sequence} {self.text}: {self.state}" + (f" – {self.answer}" if self.answer else "")


class CommandLog:
    """Latest commands, latest first."""

    def __init__(self) -> None:
        self._sequence = count(1)
        self.commands: deque[Command] = deque(maxlen=KEPT)

    def begin(self, text: str, by: str, age: float, oldest: float) -> Command:
        """Log a command of at most ``age`` [s]; raises ``RefusalError`` if it may be older than ``oldest`` [s]."""
        command = Command(next(self._sequence), text, by)
        self.commands.appendleft(command)
        if age > oldest:
            command.state = "refused"
            command.answer = f"came too late: made up to {age:.1f} s ago; expected at most {oldest:g} s"
            raise RefusalError("age", command.line())
        return command
