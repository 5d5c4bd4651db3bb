"""What no sender may exceed, and who does: for every service's inputs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Protocol

from bifrost import Limit

STREAM = Limit(rate=10_000.0, burst=2_000)
"""Of what comes every control period: many times that, for robots simulated as quickly as they can be."""
COMMANDS = Limit(rate=2_000.0, burst=500)
"""Of set-points, velocities, goals: the quickest honest sender, the VRC, sends a fourth of it."""
REQUESTS = Limit(rate=100.0, burst=100)
"""Of requests: persons and plans ask a few times a second."""

REMEMBERED = 3.0  # a sender is told for so long after it was muted last: longer than until it is muted again [s]


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
