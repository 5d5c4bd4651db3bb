"""Checks of a service's inputs: senders that flood them, and topics that are late or invalid."""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, Self, TypeVar

from bifrost import Limit
from bifrost.limits import Meter
from valor.common.topics import CONTROL_RATE, Topic

ROS_TOPIC = Limit(rate=500.0, burst=250)
"""Limit of one ROS topic with commands: operators and planners send fewer messages, controllers at most half."""

REMEMBERED = 3.0  # time that a flood is reported after its end; longer than the interval between mutes [s]
ENOUGH = 0.9  # minimum of a topic's rate, as a fraction of its nominal one
WINDOW = 3.0  # over which a rate is measured; shorter gaps are not reported [s]
_SAMPLE_PERIOD = 0.5  # [s]
_IN_TURN = 2_000_000_000  # in which numbers go back twice if two publishers send, once if one restarts [ns]
_NAMED = 3  # maximum number of topics in a report


M = TypeVar("M")
_log = logging.getLogger("floods")


class Input(Protocol):
    """A subscriber or server."""

    topic: str

    @property
    def muted(self) -> tuple[str, ...]:
        """Names of the nodes that it currently ignores."""


class _Memory:
    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._last: dict[str, float] = {}  # replaced as a whole: another thread reads it

    def recent(self) -> list[str]:
        """Floods in alphabetical order. From any thread."""
        now = self._clock()
        return sorted(flood for flood, at in self._last.items() if now - at < REMEMBERED)

    def note(self, flood: str) -> bool:
        """Store a flood; return whether it is a new one."""
        recent = self.recent()
        self._last = {each: self._last[each] for each in recent} | {flood: self._clock()}
        return flood not in recent


class Floods:
    """Stores which sender floods which topic."""

    def __init__(self, inputs: Iterable[Input], clock: Callable[[], float] = time.monotonic) -> None:
        self._inputs = list(inputs)
        self._memory = _Memory(clock)

    def report(self) -> str:
        """One line for the user; empty without floods."""
        for each in self._inputs:
            for name in each.muted:
                self._memory.note(f"{name} floods {each.topic}")
        recent = self._memory.recent()
        return f"{', '.join(recent)}: muted while it continues" if recent else ""


class TopicFloods:
    """Senders that flood a ROS topic: messages are counted and all publishers of the topic named, not muted.

    Publishers that send to one topic at the same time, whose commands replace each other's, are named, too.
    With one publisher, messages lost before the callback count, too; with several, only received ones do.
    """

    def __init__(self, publishers: Callable[[str], Iterable[str]], clock: Callable[[], float] = time.monotonic) -> None:
        """``publishers``: returns the names of the nodes that publish on a topic."""
        self._publishers = publishers
        self._clock = clock
        self._memory = _Memory(clock)

    def counted(self, topic: str, callback: Callable[[M], object]) -> Callable[[M, Mapping[str, int | None]], None]:
        """A callback that counts messages and passes them on; it takes a message and rclpy's message info."""
        received, sent = Meter(ROS_TOPIC), Meter(ROS_TOPIC)
        latest, back, checked = 0, -_IN_TURN, -_IN_TURN

        def count(message: M, info: Mapping[str, int | None]) -> None:
            nonlocal latest, back, checked
            now, before = int(self._clock() * 1e9), latest
            latest = info.get("publication_sequence_number") or 0
            too_much = received.exceeds(1, now)
            if 0 < latest < before:
                back, last = now, back
                if now - last < _IN_TURN <= now - checked:
                    checked, names = now, sorted(self._publishers(topic))
                    several = f"{' and '.join(names)} send to {topic} at the same time"
                    if len(names) > 1 and self._memory.note(several):
                        _log.warning("%s", several)
            # A single jump of the number comes from a change of publisher.
            passed = min(max(1, latest - before), ROS_TOPIC.burst) if before else 1
            if sent.exceeds(passed, now) or too_much:
                names = sorted(set(self._publishers(topic)))
                flood = f"{' or '.join(names) or 'an unknown node'} floods {topic}"
                if (too_much or len(names) == 1) and self._memory.note(flood):
                    _log.warning("%s: only part of its messages is processed", flood)
            callback(message)

        return count

    def report(self) -> str:
        """One line for the user; empty without floods. From any thread."""
        return ", ".join(self._memory.recent())


class CountedInput(Protocol):
    """A subscriber."""

    @property
    def sequence(self) -> int:
        """The publisher's count at the latest message; 0: none yet."""

    @property
    def rejected(self) -> int:
        """Messages rejected since start."""


@dataclass(frozen=True)
class _Sample:
    """Counts at one time: latest sequence, and rejected messages, of each input."""

    wall: float  # [s]
    robot: float  # [s]
    counts: Mapping[Topic[Any], tuple[int, int]]

    def elapsed_since(self, then: Self) -> float:
        """Time by the clock that has advanced less [s]."""
        return min(self.wall - then.wall, self.robot - then.robot)


class Freshness:
    """Compares the rates of topics, by their publishers' counts, with the table of topics.

    Of robot time and wall time the one that has advanced less counts, as robot time may be paused. Topics
    without a rate, or that never arrived, are not judged; a restarted publisher starts a new window.
    """

    def __init__(
        self,
        inputs: Mapping[Topic[Any], CountedInput],
        control_rate: float,
        robot_time: Callable[[], int],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start without samples; ``robot_time``: the latest that the service has received [ns]."""
        self._inputs = inputs
        self._rates = {topic: control_rate if topic.rate == CONTROL_RATE else topic.rate for topic in inputs}
        self._robot_time, self._clock = robot_time, clock
        self._samples: deque[_Sample] = deque()

    def report(self) -> str:
        """One line for the user, as ``motion_manager/motor: 312 of 500 Hz``; empty without faults."""
        counts = {topic: (each.sequence, each.rejected) for topic, each in self._inputs.items()}
        now = _Sample(self._clock(), self._robot_time() * 1e-9, counts)
        if self._samples and now.robot < self._samples[-1].robot:
            self._samples.clear()  # robot time has restarted
        while len(self._samples) > 1 and now.elapsed_since(self._samples[1]) >= WINDOW:
            self._samples.popleft()
        found = self._faults(self._samples[0], now) if self._samples else []
        if not self._samples or now.wall - self._samples[-1].wall >= _SAMPLE_PERIOD:
            self._samples.append(now)
        more = [f"and {len(found) - _NAMED} more"] if len(found) > _NAMED else []
        return "; ".join(found[:_NAMED] + more)

    def _faults(self, then: _Sample, now: _Sample) -> list[str]:
        elapsed = now.elapsed_since(then)
        if elapsed < WINDOW:
            return []
        found = []
        for topic, (sequence, rejected) in now.counts.items():
            before, rejected_before = then.counts[topic]
            rate, count = self._rates[topic], sequence - before
            if rejected > rejected_before:
                found.append(f"{topic.name}: {rejected - rejected_before} rejected")
            elif rate is None or before == 0 or count < 0:
                continue
            elif count == 0:
                found.append(f"{topic.name}: silent")
            elif count < ENOUGH * rate * elapsed - 1:
                found.append(f"{topic.name}: {count / elapsed:.3g} of {rate:g} Hz")
        return found
