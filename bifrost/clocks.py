"""How far the monotonic clock of another computer is ahead of ours, as D. L. Mills' RFC 5905 takes it from round trips.

A question is sent at one time of ours and its answer back at another; the other computer had it in between. So the
offset is known to half the round trip, and with age to less, for clocks drift. The best of the last samples counts.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

DRIFT = 100e-6  # of two quartz clocks against each other, at most
SAMPLES = 256  # a second apart
SPAN = 20.0  # over which a drift is told at least [s]


class OtherClock:
    """The clock of another computer, for those who bring its stamps to ours. Written by one thread, read by any.

    Attributes:
        ahead: of ours [ns].
        known: whether it has been measured.
    """

    __slots__ = ("ahead", "known")

    def __init__(self) -> None:
        self.ahead = 0
        self.known = False


OWN_CLOCK = OtherClock()
OWN_CLOCK.known = True


@dataclass(frozen=True)
class Sample:
    """One round trip, by our clock: when it was back, how far the other was ahead, and to which error, all [ns]."""

    back: int
    ahead: int
    error: int


class ClockFilter:
    """Keeps the last round trips to another computer's clock."""

    def __init__(self) -> None:
        self._samples: deque[Sample] = deque(maxlen=SAMPLES)

    def add(self, sent: int, taken: int, back: int) -> None:
        """A question and its answer: sent and back by our clock, taken by the other's [ns]. Nonsense is passed over."""
        if back < sent:
            return
        ahead = taken - (sent + back) // 2
        if self._samples and abs(ahead - self._samples[-1].ahead) > 1_000_000_000:
            self._samples.clear()  # the other computer has been started anew
        self._samples.append(Sample(back, ahead, (back - sent) // 2))

    def best(self, now: int) -> Sample | None:
        """The sample that tells best how far it is ahead at ``now`` [ns], its error grown with its age; None: none."""
        best = min(self._samples, key=lambda each: self._error(each, now), default=None)
        return best and Sample(best.back, best.ahead, self._error(best, now))

    def drift(self) -> float | None:
        """By how much the other gains on ours, seconds a second; None: not known yet, or not well enough."""
        half = len(self._samples) // 2
        first, last = (
            min(part, key=lambda each: each.error, default=None)
            for part in (list(self._samples)[:half], list(self._samples)[half:])
        )
        if first is None or last is None or last.back - first.back < SPAN * 1e9:
            return None
        return (last.ahead - first.ahead) / (last.back - first.back)

    @staticmethod
    def _error(sample: Sample, now: int) -> int:
        return sample.error + round(DRIFT * (now - sample.back))
