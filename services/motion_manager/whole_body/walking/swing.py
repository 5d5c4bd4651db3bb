"""The path of a swinging foot: up and over, down to a little below the ground, and on down until it touches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from motion_manager.whole_body import rotation
from motion_manager.whole_body.reference import minimum_jerk

FloatArray = npt.NDArray[np.float64]


@dataclass(slots=True)
class SolePose:
    """Where a sole is, in odom."""

    position: FloatArray  # (3,) [m]
    rotation: FloatArray  # (3, 3)


@dataclass(slots=True)
class SwingPoint:
    """Where a swinging sole shall be, in odom."""

    position: FloatArray  # (3,) [m]
    rotation: FloatArray  # (3, 3)
    velocity: FloatArray  # (6,) linear [m/s], angular [rad/s]
    acceleration: FloatArray  # (6,) [m/s², rad/s²]


class SwingTrajectory:
    """From rest to rest: minimum jerk in the plane and in orientation, two minimum-jerk halves in height."""

    def __init__(
        self, start: SolePose, target: SolePose, *, height: float, duration: float, depth: float, descent: float
    ) -> None:
        """Plan.

        Args:
            start: of the sole.
            target: of the sole.
            height: of the apex above the higher of both [m].
            duration: [s].
            depth: below the target, that the foot is led to [m].
            descent: speed at which it goes on down afterwards [m/s].
        """
        self._start, self._duration, self._descent = start, duration, descent
        self._way: FloatArray = target.position - start.position
        self._turn = rotation.rotation_vector(target.rotation @ start.rotation.T)
        self._apex = max(float(start.position[2]), float(target.position[2])) + height
        self._end = float(target.position[2]) - depth

    def at(self, time: float) -> SwingPoint:
        """The reference at ``time`` [s] since the start."""
        s, rate, change = minimum_jerk(time, self._duration)
        position = self._start.position + s * self._way
        velocity, acceleration = np.empty(6), np.empty(6)
        velocity[:3], velocity[3:] = rate * self._way, rate * self._turn
        acceleration[:3], acceleration[3:] = change * self._way, change * self._turn
        position[2], velocity[2], acceleration[2] = self._height(time)
        turned = rotation.from_rotation_vector(s * self._turn) @ self._start.rotation
        return SwingPoint(position, turned, velocity, acceleration)

    def _height(self, time: float) -> tuple[float, float, float]:
        """[m], [m/s], [m/s²]."""
        half = 0.5 * self._duration
        if time >= self._duration:
            return self._end - self._descent * (time - self._duration), -self._descent, 0.0
        begin, end = float(self._start.position[2]), self._apex
        if time >= half:
            begin, end = self._apex, self._end
            time -= half
        s, rate, change = minimum_jerk(time, half)
        return begin + s * (end - begin), rate * (end - begin), change * (end - begin)
