"""Whether the topics that a service lives by come as they should: alive, frequent enough, valid; and who is guilty."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from valor.common.topics import CONTROL_RATE, Topic

ENOUGH = 0.9  # of its nominal rate
WINDOW = 3.0  # over which a rate is taken: a shorter hiccup is nobody's fault [s]
_LOOK_EVERY = 0.5  # [s]
_NAMED = 3  # of several topics, so many


class Input(Protocol):
    """A subscriber."""

    @property
    def sequence(self) -> int:
        """The publisher's count with the newest message taken in; 0: none yet."""

    @property
    def rejected(self) -> int:
        """Messages refused since start."""


@dataclass(frozen=True)
class _Look:
    """What was there at one time: of each input the newest sequence, and how many messages it has refused."""

    wall: float  # [s]
    robot: float  # [s]
    counts: Mapping[Topic[Any], tuple[int, int]]


class Freshness:
    """Compares how often topics are published, by their publishers' own count, with their rows of the table.

    Some are periodic in robot time, some by the wall clock: the one that has advanced less counts, so that none is
    taken to be slow where robot time is scaled, or stands. What has never come is not judged, nor what is published
    on demand; a publisher that begins anew begins a new window.
    """

    def __init__(
        self,
        inputs: Mapping[Topic[Any], Input],
        control_rate: float,
        robot_time: Callable[[], int],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Nothing is known yet.

        Args:
            inputs: a subscriber of each topic.
            control_rate: of the robot [Hz].
            robot_time: the newest that the service knows [ns].
            clock: monotonic [s].
        """
        self._inputs = inputs
        self._rates = {topic: control_rate if topic.rate == CONTROL_RATE else topic.rate for topic in inputs}
        self._robot_time, self._clock = robot_time, clock
        self._looks: deque[_Look] = deque()

    def told(self) -> str:
        """One line for a person, as ``motion_manager/motor: 312 of 500 Hz``; empty if all is well."""
        newest = self._look()
        if self._looks and newest.robot < self._looks[-1].robot:
            self._looks.clear()  # another robot time
        while len(self._looks) > 1 and _elapsed(self._looks[1], newest) >= WINDOW:
            self._looks.popleft()
        found = self._judged(self._looks[0], newest) if self._looks else []
        if not self._looks or newest.wall - self._looks[-1].wall >= _LOOK_EVERY:
            self._looks.append(newest)
        more = [f"and {len(found) - _NAMED} more"] if len(found) > _NAMED else []
        return "; ".join(found[:_NAMED] + more)

    def _look(self) -> _Look:
        counts = {topic: (each.sequence, each.rejected) for topic, each in self._inputs.items()}
        return _Look(self._clock(), self._robot_time() * 1e-9, counts)

    def _judged(self, then: _Look, now: _Look) -> list[str]:
        elapsed = _elapsed(then, now)
        if elapsed < WINDOW:
            return []
        found = []
        for topic, (sequence, rejected) in now.counts.items():
            before, rejected_before = then.counts[topic]
            rate, count = self._rates[topic], sequence - before
            if rejected > rejected_before:
                found.append(f"{topic.name}: {rejected - rejected_before} refused")
            elif rate is None or before == 0 or count < 0:
                continue
            elif count == 0:
                found.append(f"{topic.name}: silent")
            elif count < ENOUGH * rate * elapsed - 1:
                found.append(f"{topic.name}: {count / elapsed:.3g} of {rate:g} Hz")
        return found


def _elapsed(then: _Look, now: _Look) -> float:
    """By the clock that has advanced less [s]."""
    return min(now.wall - then.wall, now.robot - then.robot)
