"""Minimum-jerk motion of joints to a posture: simultaneous arrival, limited velocity and acceleration."""

import numpy as np

from valor.common.arrays import FloatArray

# Of s(τ) = 10τ³ − 15τ⁴ + 6τ⁵ (Flash and Hogan, 1985), τ from 0 to 1.
_PEAK_VELOCITY = 1.875
_PEAK_ACCELERATION = 10.0 / 3.0**0.5


class PostureMove:
    """Motion of joints to a posture, ``goal`` (n,) [rad], in ``duration`` [s]."""

    def __init__(
        self,
        start: FloatArray,
        goal: FloatArray,
        *,
        velocity: FloatArray,
        acceleration: FloatArray,
        began: float,
        shortest: float,
    ) -> None:
        """Plan the motion from rest at ``start`` (n,) [rad] at the robot time ``began`` [s].

        Limits are ``velocity`` (n,) [rad/s] and ``acceleration`` (n,) [rad/s²]; the least duration is ``shortest`` [s].
        """
        self._start, self.goal, self._began = start.copy(), goal.copy(), began
        self._way: FloatArray = self.goal - self._start
        distance = np.abs(self._way)
        self.duration = max(
            shortest,
            _PEAK_VELOCITY * float(np.max(distance / velocity, initial=0.0)),
            float(np.sqrt(_PEAK_ACCELERATION * np.max(distance / acceleration, initial=0.0))),
        )

    def progress(self, now: float) -> float:
        """Return elapsed time relative to the duration, 0 to 1."""
        return min(1.0, max(0.0, (now - self._began) / self.duration))

    def remaining(self, now: float) -> float:
        """Return the remaining time [s]."""
        return self.duration * (1.0 - self.progress(now))

    def since_arrival(self, now: float) -> float:
        """Return the time since arrival [s]; negative before."""
        return now - self._began - self.duration

    def gone(self, now: float) -> float:
        """Return the completed share of the path, 0 to 1."""
        tau = self.progress(now)
        return tau**3 * (10.0 + tau * (6.0 * tau - 15.0))

    def at(self, now: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position [rad], velocity [rad/s] and acceleration [rad/s²], (n,) each."""
        tau = self.progress(now)
        rate = 30.0 * tau**2 * (1.0 - tau) ** 2 / self.duration
        change = 60.0 * tau * (1.0 - tau) * (1.0 - 2.0 * tau) / self.duration**2
        return self._start + self.gone(now) * self._way, rate * self._way, change * self._way
