"""What is refused of one kind of request: counted, logged within bounds, and kept for whoever tells the senders."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

LINES = 5  # of the log at once
PERIOD = 5.0  # and one more every so often [s]
AGAIN = 10.0  # after which the same line is told again, if it goes on [s]
KEPT = 10  # that wait to be told; of more, the newest
LONGEST = 64  # of what a client named, as far as it is repeated [characters]


def bounded(name: str) -> str:
    """What a client named, short enough to be repeated."""
    return name if len(name) <= LONGEST else f"{name[:LONGEST]}…"


@dataclass(frozen=True)
class Refusal:
    """One, for those whom no answer reaches."""

    reason: str
    count: int


class BoundedLog:
    """Warnings of one source, which may come a hundred times a second. From any thread."""

    def __init__(self, log: logging.Logger, clock: Callable[[], float] = time.monotonic) -> None:
        self._log = log
        self._clock = clock
        self._lines = float(LINES)
        self._since = clock()
        self._last, self._again = "", 0.0
        self._untold = 0
        self._lock = threading.Lock()

    def warning(self, line: str) -> None:
        """Log a line; not soon the same again, nor more than ``LINES`` and one every ``PERIOD``."""
        with self._lock:
            now = self._clock()
            self._lines = min(LINES, self._lines + (now - self._since) / PERIOD)
            self._since = now
            if (line == self._last and now < self._again) or self._lines < 1.0:
                self._untold += 1
                return
            self._lines -= 1.0
            self._again = now + AGAIN
            untold, self._untold, self._last = self._untold, 0, line
        self._log.warning("%s%s", line, f" ({untold} more were not told)" if untold else "")


class Refusals:
    """Of one kind of request. From any thread.

    Attributes:
        count: of all.
        last: the newest, with what was asked for; for people.
    """

    def __init__(self, log: BoundedLog, form: str) -> None:
        """``form`` of a line of the log: what was asked for goes into its braces."""
        self._log = log
        self._form = form
        self._news: deque[Refusal] = deque(maxlen=KEPT)
        self.count = 0
        self.last = ""

    def add(self, asked: str, reason: str, *, answered: bool = False) -> None:
        """Note one; ``answered``: who asked is told the reason anyway."""
        self.count += 1
        self.last = f"{asked}: {reason}"
        self._log.warning(f"{self._form.format(asked)} refused: {reason}")
        if not answered:
            self.tell(self.last)

    def tell(self, reason: str) -> None:
        """Have something told that nobody is answered."""
        self._news.append(Refusal(reason, self.count))

    def news(self) -> list[Refusal]:
        """What is to be told since the last look."""
        return [self._news.popleft() for _ in range(len(self._news))]
