"""What takes time is done by a thread of its own, one thing after the other, and told as its command's answer."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

import bifrost
from valor.common.errors import ValorError
from valor.operator_station.commands import Command
from valor.operator_station.desk import Desk, Visit


class Worker:
    """Does what the operator has asked for."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._line: queue.SimpleQueue[tuple[Callable[[], str], Command] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="worker", daemon=True)
        self._thread.start()

    def doing(self, text: str, act: Callable[[], str]) -> Callable[[Visit], None]:
        """What a button does: a command of that text; ``act`` returns its answer, or raises what was wrong."""
        return lambda visit: self.do(visit, text, act)

    def do(self, visit: Visit, text: str, act: Callable[[], str]) -> None:
        """Likewise, at once.

        Raises:
            RefusalError: as of ``Desk.command``.
        """
        self._line.put((act, self._desk.command(visit, text)))

    def _work(self) -> None:
        while (task := self._line.get()) is not None:
            act, command = task
            try:
                command.answer, command.state = act(), "done"
            except bifrost.NoServerError:
                command.answer, command.state = "nobody serves it: the process that does is not up", "refused"
            except (ValorError, bifrost.Error, OSError) as error:
                command.answer, command.state = str(error), "refused"

    def close(self) -> None:
        """Do nothing more."""
        self._line.put(None)
        self._thread.join(timeout=2.0)
