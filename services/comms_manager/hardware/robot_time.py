"""Robot time by the devices' own clock, as a bus' reference clock is in distributed clocks.

Emulators on a computer that is too slow are slow robots, not wrong ones.
"""

from __future__ import annotations

from collections.abc import Callable

# So much may lack of a period. Less than half, or whoever is late once samples twice a period for ever; and no whole
# millisecond of 4 or 5 ms, the grain of an emulator's clock.
LACKING = 0.45


class RobotTime:
    """How much robot time has passed with the newest states.

    Attributes:
        now: of the newest states [ns].
        is_lost: the clock is: a period is a period.
    """

    def __init__(self, elapsed: Callable[[], int] | None, period: float, now: int) -> None:
        """Begin.

        Args:
            elapsed: by the reference clock [ns]; None: no device has one.
            period: of control [s].
            now: robot time [ns].
        """
        self._clock, self._period = elapsed, period
        self._elapsed = elapsed() if elapsed else 0
        self.now = now
        self.is_lost = False

    @property
    def lacking(self) -> float:
        """Of a period since the last one ended, by the devices' clock [s]; 0: it is over."""
        if self._clock is None:
            return 0.0
        lacking = self._period - 1e-9 * (self._clock() - self._elapsed)
        return lacking if lacking >= LACKING * self._period else 0.0

    def pass_period(self, lost: bool) -> None:
        """The period has ended; ``lost``: whatever the clock says."""
        elapsed = round(1e9 * self._period)
        if self._clock is not None:
            now = self._clock()
            if not lost:
                elapsed = now - self._elapsed
            self._elapsed = now
        self.is_lost = lost
        self.now += elapsed
