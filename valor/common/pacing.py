"""How robot time is kept beside the wall's.

Nobody ever catches up on missed periods: when late, the schedule moves, and the lost time is slip.
"""

from __future__ import annotations

import ctypes
import time

LATE = 0.002  # behind the schedule by more than this, the schedule moves [s]


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
    """

    def __init__(self, rate: float, wall: Wall) -> None:
        """``rate``: robot time to wall time; 0: no schedule."""
        self._rate = rate
        self._wall = wall
        self._due: float | None = None
        self.slip = 0.0

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
        if now - self._due > LATE:
            if self._rate:
                self.slip += (now - self._due) * rate
            self._due = now
        return self._due - now

    def remaining(self) -> float:
        """How long the end is still away [s]."""
        return 0.0 if self._due is None else self._due - self._wall.now()
