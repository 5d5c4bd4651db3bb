"""How robot time is kept beside the wall's.

What is late is made up within bounds; beyond them the schedule moves, and the lost time is slip.
"""

from __future__ import annotations

import ctypes
import math
import time

LATE = 0.002  # so far behind the schedule is made up at once [s]


class Wall:
    """The wall clock."""

    def __init__(self) -> None:
        # Linux wakes a sleeper up to 50 µs late to save energy, unless asked not to (PR_SET_TIMERSLACK).
        ctypes.CDLL(None).prctl(29, 1000, 0, 0, 0)

    def now(self) -> float:
        """[s]."""
        return time.perf_counter()

    def sleep(self, duration: float) -> None:
        """Sleep [s]."""
        time.sleep(duration)


class Pacer:
    """Keeps robot time to a schedule on the wall.

    Attributes:
        slip: robot time lost: how much less has passed than the schedule first had it [s].
        end: when the time that passes now is to have passed, on the wall [s].
    """

    def __init__(self, rate: float, wall: Wall, backlog: float = LATE, haste: float = math.inf) -> None:
        """Begin with the first time that passes.

        Args:
            rate: robot time to wall time; 0: no schedule.
            wall: the clock to keep to.
            backlog: behind the schedule by more than this, the schedule moves [s of the wall].
            haste: to make up what is late, robot time passes at most so much quicker than ``rate``.
        """
        self._rate = rate
        self._wall = wall
        self._backlog = backlog
        self._haste = haste
        self._due: float | None = None
        self._passed = -math.inf  # when the time that passed last had passed, on the wall [s]
        self.end = 0.0
        self.slip = 0.0

    def begin_anew(self, rate: float) -> None:
        """Keep another schedule from now on, robot time to wall time; what passed meanwhile is nowhere late."""
        self._rate, self._due, self._passed = rate, None, -math.inf

    def pass_time(self, duration: float, at_least_real_time: bool = False) -> float:
        """Let a duration of robot time pass: sleep until its end is due. Returns the time slept [s].

        Args:
            duration: [s].
            at_least_real_time: keep to real time where there is no schedule.
        """
        now = self._wall.now()
        remaining = self.next(duration, at_least_real_time)
        if remaining <= 0.0:
            return 0.0
        self._wall.sleep(remaining)
        return self._wall.now() - now

    def next(self, duration: float, at_least_real_time: bool = False) -> float:
        """As ``pass_time``, without sleeping: returns how long the end is still away [s], negative if it has passed."""
        rate = self._rate or (1.0 if at_least_real_time else 0.0)
        now = self._wall.now()
        if self._due is None or not rate:
            self._due = now
        if not rate:
            return 0.0
        self._due += duration / rate
        if now - self._due > self._backlog:
            if self._rate:
                self.slip += (now - self._due) * rate
            self._due = now
        self.end = max(self._due, self._passed + duration / rate / self._haste)
        self._passed = max(self.end, now)
        return self.end - now
