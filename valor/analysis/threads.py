"""What the threads of processes use of the cores, and wait for them: from Linux' own account, without privileges."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class ThreadUse:
    """One thread over a span of time.

    Attributes:
        running: on a core [% of the time].
        waiting: ready to run, without a core [% of the time].
        turns: how often it was given a core [1/s].
    """

    process: str
    name: str
    running: float
    waiting: float
    turns: float


class ThreadWatch:
    """Looks at the threads of some processes, now and again later."""

    def __init__(self, pids: Mapping[str, int]) -> None:
        """``pids``: of the processes, by name."""
        self._pids = dict(pids)
        self._began = time.monotonic()
        self._before = self._look()

    def use(self) -> list[ThreadUse]:
        """Of all threads that ran since this was made, the busiest first."""
        elapsed = time.monotonic() - self._began
        uses = []
        for (process, thread), (name, now) in self._look().items():
            _, before = self._before.get((process, thread), (name, (0, 0, 0)))
            running, waiting, turns = (b - a for a, b in zip(before, now, strict=True))
            if turns > 0:
                share = 100e-9 / elapsed
                uses.append(ThreadUse(process, name, running * share, waiting * share, turns / elapsed))
        return sorted(uses, key=lambda use: -use.running)

    def _look(self) -> dict[tuple[str, str], tuple[str, tuple[int, ...]]]:
        """Name, and nanoseconds on a core, nanoseconds waiting for one and turns since its start, by thread."""
        seen = {}
        for process, pid in self._pids.items():
            with suppress(OSError):  # it has ended
                for task in Path(f"/proc/{pid}/task").iterdir():
                    with suppress(OSError):
                        counts = tuple(map(int, (task / "schedstat").read_text().split()))
                        seen[process, task.name] = (task / "comm").read_text().strip(), counts
        return seen
