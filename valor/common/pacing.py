"""Schedule of robot time on the wall clock: lateness within bounds is made up; beyond, it is slip."""

import ctypes
import math
import time

LATE = 0.002  # lateness that is made up at once [s]


class WallClock:
    """The wall clock."""

    def __init__(self) -> None:
        # Linux wakes a sleeper up to 50 µs late to save energy, unless requested otherwise (PR_SET_TIMERSLACK).
        ctypes.CDLL(None).prctl(29, 1000, 0, 0, 0)

    def now(self) -> float:
        """Time [s]."""
        return time.perf_counter()

    def sleep(self, duration: float) -> None:
        """Sleep [s]."""
        time.sleep(duration)


class Pacer:
    """Keeps robot time to a schedule on the wall clock."""

    def __init__(self, rate: float, wall: WallClock, backlog: float = LATE, haste: float = math.inf) -> None:
        """Create a schedule that starts with the first step.

        Args:
            rate: robot time per wall time; 0: no schedule.
            wall: reference clock.
            backlog: lateness beyond which the schedule moves, on the wall clock [s].
            haste: maximum of the rate, as a multiple of ``rate``, while lateness is made up.
        """
        self._rate = rate
        self._wall = wall
        self._backlog = backlog
        self._haste = haste
        self._due: float | None = None
        self._passed = -math.inf  # end of the last step, on the wall clock [s]
        self.end = 0.0  # of the present step, as scheduled on the wall clock [s]
        self.slip = 0.0  # robot time lost against the first schedule [s]

    def restart(self, rate: float) -> None:
        """Start another schedule, of robot time per wall time; the time until now is not late."""
        self._rate, self._due, self._passed = rate, None, -math.inf

    def pass_time(self, duration: float, at_least_real_time: bool = False) -> float:
        """Sleep until the end of a step of robot time [s]. Returns the time slept [s].

        ``at_least_real_time``: keep to real time where there is no schedule.
        """
        now = self._wall.now()
        remaining = self.next(duration, at_least_real_time)
        if remaining <= 0.0:
            return 0.0
        self._wall.sleep(remaining)
        return self._wall.now() - now

    def next(self, duration: float, at_least_real_time: bool = False) -> float:
        """Time until the end of a step [s], negative if it has passed; as ``pass_time``, without sleeping."""
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
