"""Offset of another computer's monotonic clock, estimated from round trips as in RFC 5905 (D. L. Mills).

The other computer receives a request between its sending and the receipt of the reply. The error of the offset is half
the round trip, and grows with age, for clocks drift. The best of the last samples counts.
"""

from collections import deque
from dataclasses import dataclass

DRIFT = 100e-6  # maximum drift between two quartz clocks
SAMPLES = 256  # one per second


class OtherClock:
    """The clock of another computer, for conversion of its stamps. Written by one thread, read by any."""

    __slots__ = ("ahead", "known")

    def __init__(self) -> None:
        self.ahead = 0  # offset to this computer's clock [ns]
        self.known = False  # whether the offset has been measured


OWN_CLOCK = OtherClock()
OWN_CLOCK.known = True


@dataclass(frozen=True)
class Sample:
    """One round trip: time of its end by the local clock, offset of the other clock, and error, all [ns]."""

    back: int
    ahead: int
    error: int


class ClockFilter:
    """Stores the last round trips to another computer."""

    def __init__(self) -> None:
        self._samples: deque[Sample] = deque(maxlen=SAMPLES)

    def add(self, sent: int, taken: int, back: int) -> None:
        """Add a round trip: sent and back by the local clock, taken by the other [ns]. Impossible ones are ignored."""
        if back < sent:
            return
        ahead = taken - (sent + back) // 2
        if self._samples and abs(ahead - self._samples[-1].ahead) > 1_000_000_000:
            self._samples.clear()  # the other computer has restarted
        self._samples.append(Sample(back, ahead, (back - sent) // 2))

    def best(self, now: int) -> Sample | None:
        """The sample with the smallest error at ``now`` [ns], its age included; None without samples."""
        best = min(self._samples, key=lambda each: self._error(each, now), default=None)
        return best and Sample(best.back, best.ahead, self._error(best, now))

    @staticmethod
    def _error(sample: Sample, now: int) -> int:
        return sample.error + round(DRIFT * (now - sample.back))
