"""Motion of joints to a posture: simultaneous arrival, limited velocity and acceleration.

The joints move with minimum jerk. If velocity limits the duration, they may keep their velocity between both halves.
"""

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
        cruise: float = 0.0,
    ) -> None:
        """Plan the motion from rest at ``start`` (n,) [rad] at the robot time ``began`` [s].

        Limits are ``velocity`` (n,) [rad/s] and ``acceleration`` (n,) [rad/s²]; the least duration is ``shortest`` [s].
        The share of the duration at steady velocity is ``cruise`` at most.
        """
        self._start, self.goal, self._began = start.copy(), goal.copy(), began
        self._way: FloatArray = self.goal - self._start
        distance, gain = np.abs(self._way), _PEAK_VELOCITY - 1.0
        fastest = _PEAK_VELOCITY * float(np.max(distance / velocity, initial=0.0))  # at minimum jerk
        sharpest = _PEAK_ACCELERATION * float(np.max(distance / acceleration, initial=0.0))
        if sharpest:  # a longer cruise would need more acceleration
            cruise = min(cruise, max(0.0, (fastest**2 - sharpest) / (fastest**2 + gain * sharpest)))
        self.duration = max(shortest, fastest / (1.0 + gain * cruise), float(np.sqrt(sharpest)))
        self._jerked = 1.0 - max(0.0, fastest - self.duration) / (gain * self.duration or 1.0)  # share at minimum jerk
        self._scale = self._jerked / (self._jerked + _PEAK_VELOCITY * (1.0 - self._jerked))

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
        near = min(tau, 1.0 - tau)  # of an end
        u = min(0.5, near / self._jerked)
        steady = near / self._jerked - u
        gone = self._scale * (u**3 * (10.0 + u * (6.0 * u - 15.0)) + _PEAK_VELOCITY * steady)
        return gone if tau < 0.5 else 1.0 - gone

    def at(self, now: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position [rad], velocity [rad/s] and acceleration [rad/s²], (n,) each."""
        tau = self.progress(now)
        u = min(0.5, min(tau, 1.0 - tau) / self._jerked)
        time = self._jerked * self.duration
        rate = self._scale * 30.0 * u**2 * (1.0 - u) ** 2 / time
        change = self._scale * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / time**2
        change = change if tau < 0.5 else -change
        return self._start + self.gone(now) * self._way, rate * self._way, change * self._way
