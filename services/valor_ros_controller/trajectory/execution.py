"""Trajectories in execution."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits


class Trajectory:
    """Trajectory of all n joints of a controller, on robot time. Past its end it stays at the last position."""

    def __init__(self, knots: Sequence[int], coefficients: FloatArray, final: FloatArray) -> None:
        """``knots``: k + 1 robot times [ns]; ``coefficients``: (k, 6, n); ``final``: (n,) last position [rad or m]."""
        self._knots = list(knots)
        self._coefficients = coefficients
        self._final = final
        self._segment = 0
        self._matrix = np.zeros((3, 6))
        self._matrix[0, 0] = self._matrix[1, 1] = 1.0
        self._matrix[2, 2] = 2.0
        # robot times of the creation and of the last point [ns]
        self.start, self.end = self._knots[0], self._knots[-1]

    @classmethod
    def holding(cls, now: int, position: FloatArray) -> Trajectory:
        return cls([now], np.zeros((0, 6, len(position))), position.copy())

    @classmethod
    def stopping(
        cls, now: int, position: FloatArray, velocity: FloatArray, deceleration: FloatArray, limits: CommandedLimits
    ) -> Trajectory:
        """Trajectory to rest from ``velocity`` (n,), each joint with its ``deceleration`` (n,) [1/s²].

        A joint that would pass its limit decelerates faster, so as to stop at it.
        """
        room = np.where(velocity > 0.0, limits.upper - position, position - limits.lower)
        room = np.maximum(room, 1e-9)
        speed = np.abs(velocity)
        deceleration = np.maximum(deceleration, speed**2 / (2.0 * room))
        duration = speed / deceleration
        rests = np.unique(np.rint(duration * 1e9).astype(np.int64))
        knots = np.concatenate(([0], rests[rests > 0]))
        # Between the stops of two joints all accelerations are constant.
        begin = np.minimum(knots[:-1, None] * 1e-9, duration)  # (k, n) time since the start of deceleration
        sign = np.sign(velocity)
        rate = velocity - sign * deceleration * begin
        coefficients = np.zeros((len(knots) - 1, 6, len(position)))
        coefficients[:, 0] = position + (velocity + rate) * (0.5 * begin)
        moving = begin < duration - 1e-9
        coefficients[:, 1] = moving * rate
        coefficients[:, 2] = moving * (-0.5 * sign * deceleration)
        final = limits.position_within(position + velocity * (0.5 * duration))
        return cls((now + knots).tolist(), coefficients, final)

    def then_resting(self, velocity: FloatArray, deceleration: FloatArray, limits: CommandedLimits) -> Trajectory:
        """This trajectory, then from ``velocity`` (n,) at its end to rest, as ``stopping``."""
        rest = Trajectory.stopping(self.end, self._final, velocity, deceleration, limits)
        coefficients = np.concatenate((self._coefficients, rest._coefficients))
        return Trajectory([*self._knots, *rest._knots[1:]], coefficients, rest._final)

    def sample(self, now: int, state: FloatArray) -> None:
        """Write position, velocity and acceleration (3, n) at a robot time [ns], which must not decrease."""
        knots = self._knots
        if now >= self.end:
            state[0], state[1:] = self._final, 0.0
            return
        segment = self._segment
        while now >= knots[segment + 1]:
            segment += 1
        self._segment = segment
        self._evaluate(segment, now, state)

    def at(self, time: int) -> FloatArray:
        """State (3, n) at any robot time [ns]; before the start that at the start."""
        state = np.zeros((3, len(self._final)))
        if time >= self.end:
            state[0] = self._final
        else:
            self._evaluate(max(0, bisect_right(self._knots, time) - 1), time, state)
        return state

    def _evaluate(self, segment: int, time: int, state: FloatArray) -> None:
        t = max(0, time - self._knots[segment]) * 1e-9
        t2 = t * t
        t3 = t2 * t
        m = self._matrix
        m[0, 1:] = t, t2, t3, t2 * t2, t2 * t3
        m[1, 2:] = 2 * t, 3 * t2, 4 * t3, 5 * t2 * t2
        m[2, 3:] = 6 * t, 12 * t2, 20 * t3
        np.matmul(m, self._coefficients[segment], out=state)

    def delay(self, by: int) -> None:
        self._knots = [knot + by for knot in self._knots]
        self.start, self.end = self._knots[0], self._knots[-1]
