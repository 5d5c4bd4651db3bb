"""From monotonic stamps to the wall clock: the offset taken at start, and how the clocks have moved since.

The thesis (4.3.1) adds one offset, taken when the recorder starts, to every Bifrost stamp. The wall clock may be set or
slewed while a bag is recorded; the offset stays, so that intervals between messages stay exact. The middleware stamps
ROS messages with the wall clock as it is: the drift is taken off again, so that both sides stay on one axis. How the
wall clock moved goes into the bag as metadata.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

_TRIES = 20


def measure_offset() -> int:
    """Wall minus monotonic clock [ns]: of several readings the one between the closest monotonic stamps."""
    best_gap, best_offset = None, 0
    for _ in range(_TRIES):
        before = time.monotonic_ns()
        wall = time.time_ns()
        after = time.monotonic_ns()
        if best_gap is None or after - before < best_gap:
            best_gap, best_offset = after - before, wall - (before + after) // 2
    return best_offset


@dataclass(frozen=True)
class ClockChange:
    """The wall clock has moved against the monotonic one.

    Attributes:
        kind: ``step``: it was set, between two checks; ``drift``: it went slower or faster.
        monotonic: when it was seen [ns].
        moved: since the last change that was told [ns].
        drift: since the recorder's start [ns].
    """

    kind: str
    monotonic: int
    moved: int
    drift: int

    def describe(self) -> str:
        """One line."""
        how = "was set by" if self.kind == "step" else "has drifted"
        return f"the wall clock {how} {self.moved * 1e-9:+.6f} s; {self.drift * 1e-9:+.6f} s since the recorder's start"

    def metadata(self) -> dict[str, str]:
        """As it stands in the bag."""
        return {
            "monotonic_ns": str(self.monotonic),
            "moved_ns": str(self.moved),
            "drift_ns": str(self.drift),
        }


class WallClock:
    """Turns monotonic stamps [ns] into wall clock stamps [ns].

    Attributes:
        offset: wall minus monotonic at start [ns]; added to every stamp.
        drift: how much more it is now [ns], as last checked.
        steps: how often the wall clock was set.
    """

    NOTABLE = 1_000_000  # [ns] of change between two reports
    STEP = 20_000_000  # [ns] between two checks, a second apart: more than a clock is slewed

    def __init__(self) -> None:
        self.offset = measure_offset()
        self.drift = self.steps = 0
        self._reported = 0

    def moved(self) -> bool:
        """Whether the wall clock seems to have been set since the last check; quick, and right when it says no."""
        return abs(time.time_ns() - time.monotonic_ns() - self.offset - self.drift) >= self.NOTABLE

    def check(self) -> ClockChange | None:
        """Measure the drift; how the wall clock has moved, if notably since last told."""
        before = self.drift
        self.drift = measure_offset() - self.offset
        moved = self.drift - self._reported
        if abs(moved) < self.NOTABLE:
            return None
        self._reported = self.drift
        stepped = abs(self.drift - before) >= self.STEP
        self.steps += stepped
        return ClockChange("step" if stepped else "drift", time.monotonic_ns(), moved, self.drift)

    def metadata(self) -> dict[str, str]:
        """As it stands at the end of a bag."""
        return {
            "wall_minus_monotonic_ns": str(self.offset),
            "drift_ns": str(self.drift),
            "steps": str(self.steps),
        }
