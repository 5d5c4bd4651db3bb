"""Rejected requests of one kind: counted, logged at a bounded rate and queued for publication."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable

LINES = 5  # of the log in a burst
PERIOD = 5.0  # of further lines [s]
REPEAT_PERIOD = 10.0  # of an identical line [s]
QUEUE = 10  # latest reasons to publish
MAX_NAME = 64  # quoted characters of a client's text


def bounded(name: str) -> str:
    """Text of a client, cut for quoting."""
    return name if len(name) <= MAX_NAME else f"{name[:MAX_NAME]}…"


class BoundedLog:
    """Warnings of one source at a bounded rate. Thread-safe."""

    def __init__(self, log: logging.Logger, clock: Callable[[], float] = time.monotonic) -> None:
        self._log, self._clock = log, clock
        self._lines = float(LINES)
        self._since = clock()
        self._last, self._repeat_at = "", 0.0
        self._omitted = 0
        self._lock = threading.Lock()

    def warning(self, line: str) -> None:
        """Log a line: ``LINES`` in a burst, then one every ``PERIOD``; an identical one every ``REPEAT_PERIOD``."""
        with self._lock:
            now = self._clock()
            self._lines = min(LINES, self._lines + (now - self._since) / PERIOD)
            self._since = now
            if (line == self._last and now < self._repeat_at) or self._lines < 1.0:
                self._omitted += 1
                return
            self._lines -= 1.0
            self._repeat_at = now + REPEAT_PERIOD
            omitted, self._omitted, self._last = self._omitted, 0, line
        self._log.warning("%s%s", line, f" ({omitted} more omitted)" if omitted else "")


class RejectionLog:
    """Rejections of one kind of request. Thread-safe."""

    def __init__(self, log: BoundedLog, form: str) -> None:
        """``form``: text of a log line, with braces for the request."""
        self._log, self._form = log, form
        self._pending: deque[tuple[str, int]] = deque(maxlen=QUEUE)
        self.count = 0  # total
        self.last = ""  # latest request and reason, human-readable

    def add(self, request: str, reason: str, *, answered: bool = False) -> None:
        """Count and log a rejection; publish it unless the client is ``answered`` directly."""
        self.count += 1
        self.last = f"{request}: {reason}"
        self._log.warning(f"{self._form.format(request)} rejected: {reason}")
        if not answered:
            self.publish(self.last)

    def publish(self, reason: str) -> None:
        self._pending.append((reason, self.count))

    def drain(self) -> list[tuple[str, int]]:
        """Queued reasons, each with the count at its time."""
        return [self._pending.popleft() for _ in range(len(self._pending))]
