"""``/rosout``: what a process logs goes there too, with its node's name and level, bounded.

The log file has every line; here floods are thinned out, and what was left out is counted. Whoever logs is never held
up: lines wait in a queue, and the thread that spins the node publishes them.
"""

from __future__ import annotations

import contextlib
import logging
import sys
import time
from collections import Counter, deque
from collections.abc import Callable

from rcl_interfaces.msg import Log
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from valor.common.errors import ConfigurationError

TOPIC = "/rosout"
LEAVING = Duration(seconds=0.5)  # in which the last lines are to reach those who listen
MEETING = (0.5, 2.0)  # after it began, whoever listens has been met; and if nobody has been by then, nobody does [s]
_LOOK_EVERY = 0.02  # [s]
_QOS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Who joins late is told the newest lines, as by rcl's own."""


class Sieve:
    """Lets so many lines of a kind, and of all, through in a while. What is remembered is bounded."""

    WINDOW = 1.0  # [s]
    ALIKE = 2  # of the same text
    OF_A_KIND = 10  # of the same call with whatever arguments
    IN_ALL = 50

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._began = -self.WINDOW
        self._seen: Counter[object] = Counter()
        self._passed = self._left_out = 0

    def passes(self, kind: object, text: str) -> bool:
        """Whether a line goes through."""
        now = self._clock()
        if now - self._began >= self.WINDOW:
            self._began, self._passed = now, 0
            self._seen.clear()
        through = (
            self._passed < self.IN_ALL and self._seen[kind] < self.OF_A_KIND and self._seen[(kind, text)] < self.ALIKE
        )
        if through:
            self._passed += 1
            self._seen[kind] += 1
            self._seen[(kind, text)] += 1
        else:
            self._left_out += 1
        return through

    def left_out(self) -> int:
        """How many lines were not let through since the last call."""
        count, self._left_out = self._left_out, 0
        return count


class RosOut(logging.Handler):
    """Takes what is logged in the process to ``/rosout``, from INFO on."""

    WAITING = 200  # lines that wait for the ROS thread; more, and the oldest are let go

    def __init__(self, node: Node) -> None:
        """Begin; lines go out whenever the node is spun."""
        super().__init__(logging.INFO)
        self._name = node.get_logger().name
        self._sieve = Sieve()
        self._waiting: deque[Log] = deque(maxlen=self.WAITING)
        self._publisher = node.create_publisher(Log, TOPIC, _QOS)
        self._guard = node.create_guard_condition(self._publish)
        self._began = time.monotonic()
        self._grave = False  # an error is among what was published
        self._finished = False
        logging.getLogger().addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Let a line wait, if it passes; any thread, and never for long."""
        try:
            text = record.getMessage()
            if not self._sieve.passes((record.name, record.levelno, record.msg), text):
                return
            if missing := self._sieve.left_out():
                self._wait(logging.WARNING, f"{missing} lines left out: too many; the log file has them all")
            if record.exc_info and record.exc_info[1] is not None:
                text = f"{text}: {type(record.exc_info[1]).__name__}: {record.exc_info[1]}"
            self._wait(record.levelno, text, record)
            self._guard.trigger()
        except Exception:  # as every handler: a line that cannot be told must not end who logs it
            self.handleError(record)

    def _wait(self, level: int, text: str, record: logging.LogRecord | None = None) -> None:
        line = Log(level=min(level // 10 * 10, logging.CRITICAL))  # Log's levels have logging's numbers
        line.stamp.sec, line.stamp.nanosec = divmod(time.time_ns(), 1_000_000_000)
        line.name, line.msg = self._name, text
        if record is not None:
            line.file, line.function, line.line = f"{record.module}.py", record.funcName or "", record.lineno
        self._waiting.append(line)

    def _publish(self) -> None:
        while self._waiting:
            line = self._waiting.popleft()
            self._grave = self._grave or line.level >= logging.ERROR
            self._publisher.publish(line)

    def flush(self) -> None:
        """The last lines of a process that ends without ``finish``, as the interpreter's end has it."""
        if not self._finished:
            with contextlib.suppress(Exception):  # ROS may be gone already
                self.finish()

    def finish(self) -> None:
        """The last lines, and the error for which one leaves; nobody spins the node any more."""
        self._finished = True
        logging.getLogger().removeHandler(self)
        if isinstance(error := sys.exc_info()[1], ConfigurationError):
            self._wait(logging.ERROR, str(error))
        self._publish()
        while self._grave and self._unmet():
            time.sleep(_LOOK_EVERY)
        self._publisher.wait_for_all_acked(LEAVING)

    def _unmet(self) -> bool:
        """Whether somebody may listen whom the publisher has not met yet: it has just begun."""
        soon, late = MEETING
        age = time.monotonic() - self._began
        return age < (soon if self._publisher.get_subscription_count() else late)
