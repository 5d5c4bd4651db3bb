"""Conversion of monotonic stamps to the wall clock: a constant offset, and the drift of the wall clock since then.

The thesis (4.3.1) adds one offset, measured when the recorder starts, to every Bifrost stamp. It stays constant if the
wall clock is set or slewed, so that intervals between messages stay exact. From ROS messages, stamped with the wall
clock, the recorder subtracts the drift, so that all messages share one time axis. The bag's metadata has the drift.
"""

import time
from dataclasses import dataclass

_TRIES = 20


def measure_offset() -> int:
    """Wall minus monotonic clock [ns]: of several readings, the one between the closest monotonic stamps."""
    readings = []
    for _ in range(_TRIES):
        before, wall, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        readings.append((after - before, wall - (before + after) // 2))
    return min(readings)[1]


@dataclass(frozen=True)
class ClockChange:
    """A movement of the wall clock against the monotonic clock."""

    kind: str  # ``step`` if the clock was set between two checks, ``drift`` if it ran slower or faster
    monotonic: int  # time of detection [ns]
    moved: int  # since the last reported change [ns]
    drift: int  # since the recorder's start [ns]

    def describe(self) -> str:
        how = "was set by" if self.kind == "step" else "has drifted"
        return f"the wall clock {how} {self.moved * 1e-9:+.6f} s; {self.drift * 1e-9:+.6f} s since the recorder's start"

    def metadata(self) -> dict[str, str]:
        return {"monotonic_ns": str(self.monotonic), "moved_ns": str(self.moved), "drift_ns": str(self.drift)}


class StampConverter:
    """Converter of monotonic stamps [ns] to wall clock stamps [ns]."""

    NOTABLE = 1_000_000  # least change that is reported [ns]
    STEP = 20_000_000  # least change within a second that slewing cannot explain [ns]

    def __init__(self) -> None:
        self.offset = measure_offset()  # wall minus monotonic clock at the start [ns]; added to every stamp
        self.drift = 0  # change of that difference up to the last check [ns]
        self.steps = 0  # number of times the wall clock was set
        self._reported = 0

    def moved(self) -> bool:
        """Return whether the wall clock may have been set since the last check: a fast test without false negatives."""
        return abs(time.time_ns() - time.monotonic_ns() - self.offset - self.drift) >= self.NOTABLE

    def check(self) -> ClockChange | None:
        """Measure the drift; returns the movement since the last report, if it is notable."""
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
        return {
            "wall_minus_monotonic_ns": str(self.offset),
            "drift_ns": str(self.drift),
            "steps": str(self.steps),
        }
