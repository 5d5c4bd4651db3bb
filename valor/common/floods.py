"""What no sender may exceed, and who does: for every service's inputs."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Protocol, TypeVar

from bifrost import Limit
from bifrost.limits import Meter

STREAM = Limit(rate=10_000.0, burst=2_000)
"""Of what comes every control period: many times that, for robots simulated as quickly as they can be."""
COMMANDS = Limit(rate=2_000.0, burst=500)
"""Of set-points, velocities, goals: the quickest honest sender, the VRC, sends a fourth of it."""
REQUESTS = Limit(rate=100.0, burst=100)
"""Of requests: persons and plans ask a few times a second."""

ROS_TOPIC = Limit(rate=500.0, burst=250)
"""Of what comes on one ROS topic with commands: persons and planners send less, and controllers half of it."""

REMEMBERED = 3.0  # a sender is told for so long after it was muted last: longer than until it is muted again [s]


M = TypeVar("M")
_log = logging.getLogger("floods")


class Input(Protocol):
    """A subscriber or server."""

    topic: str

    @property
    def muted(self) -> tuple[str, ...]:
        """Names of the nodes that it does not listen to now."""


class Floods:
    """Remembers which sender floods which topic."""

    def __init__(self, inputs: Iterable[Input], clock: Callable[[], float] = time.monotonic) -> None:
        self._inputs = list(inputs)
        self._clock = clock
        self._last: dict[str, float] = {}

    def told(self) -> str:
        """One line for a person; empty if nobody floods anything."""
        now = self._clock()
        for each in self._inputs:
            for name in each.muted:
                self._last[f"{name} floods {each.topic}"] = now
        self._last = {flood: at for flood, at in self._last.items() if now - at < REMEMBERED}
        return f"{', '.join(sorted(self._last))}: muted while it goes on" if self._last else ""


class TopicFloods:
    """Who floods a ROS topic. What is taken of it is bounded elsewhere; here it is counted, and who sends it named.

    ROS does not say whom a message is from: named are all who publish on the topic. Of one publisher all messages
    count, those lost on their way to the callback, too; of several, whose numbers tell nothing, those that are taken.
    """

    def __init__(self, publishers: Callable[[str], Iterable[str]], clock: Callable[[], float] = time.monotonic) -> None:
        """Nothing floods yet.

        Args:
            publishers: names of the nodes that publish on a topic.
            clock: monotonic [s].
        """
        self._publishers = publishers
        self._clock = clock
        self._last: dict[str, float] = {}  # replaced as a whole: told from another thread

    def counted(self, topic: str, callback: Callable[[M], object]) -> Callable[[M, Mapping[str, int | None]], None]:
        """A callback that counts what it is called with, and then calls the one that is given.

        It takes a message, and what rclpy tells of it.
        """
        taken, sent = Meter(ROS_TOPIC), Meter(ROS_TOPIC)
        newest = 0

        def count(message: M, info: Mapping[str, int | None]) -> None:
            nonlocal newest
            now, before = int(self._clock() * 1e9), newest
            newest = info.get("publication_sequence_number") or 0
            too_much = taken.exceeds(1, now)
            # One jump alone is another publisher's turn.
            passed = min(max(1, newest - before), ROS_TOPIC.burst) if before else 1
            if sent.exceeds(passed, now) or too_much:
                names = sorted(set(self._publishers(topic)))
                if too_much or len(names) == 1:
                    self._note(f"{' or '.join(names) or 'somebody'} floods {topic}")
            callback(message)

        return count

    def told(self) -> str:
        """One line for a person; empty if nobody floods anything. From any thread."""
        now = self._clock()
        return ", ".join(sorted(flood for flood, at in self._last.items() if now - at < REMEMBERED))

    def _note(self, flood: str) -> None:
        now = self._clock()
        if now - self._last.get(flood, -REMEMBERED) >= REMEMBERED:
            _log.warning("%s: a part of it is taken", flood)
        recent = {each: at for each, at in self._last.items() if now - at < REMEMBERED}
        self._last = {**recent, flood: now}
