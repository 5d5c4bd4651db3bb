"""Makes any stream of targets safe to follow: no jump in position, none in velocity, no limit passed."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel, clipped
from valor.robot.commanded_limits import CommandedLimits

Joints = npt.NDArray[np.bool_]  # (n,) which ones

BRAKE_FACTOR = 0.9  # of the acceleration, that braking is planned with


class Limiter:
    """Commanded positions, each of which follows a target with limited velocity and acceleration.

    A target that keeps the limits is followed exactly, one that does not as fast as the limits allow, without
    overshoot. What is commanded stays within the position limits; what is found outside them comes in from there.
    Units are those of the quantity, [rad] or [m].

    Attributes:
        position: (n,) commanded.
        velocity: (n,) commanded [1/s].
        acceleration: (n,) commanded [1/s²].
        limits: what is kept.
    """

    def __init__(self, limits: CommandedLimits) -> None:
        """At rest at 0, or at the limit next to it."""
        n = len(limits.names)
        self.limits = limits
        self._brake: FloatArray = BRAKE_FACTOR * limits.acceleration
        self.position = limits.position_within(np.zeros(n))
        self.velocity = np.zeros(n)
        self.acceleration = np.zeros(n)
        self._asked, self._dt, self._next = np.zeros((4, n)), np.zeros(1), np.zeros((3, n))
        self._evaluate = Kernel("limiter", self._expressions, (self._asked, self._dt), (self._next,))
        self._before = b""  # what was asked last; empty: not by what it gave

    def reset(self, joints: Joints, position: FloatArray) -> None:
        """Take some up, at rest, where they are found.

        Args:
            joints: (n,) which ones.
            position: (n,) where.
        """
        self._before = b""
        self.position = np.where(joints, position, self.position)
        self.velocity = np.where(joints, 0.0, self.velocity)
        self.acceleration = np.where(joints, 0.0, self.acceleration)

    def stopping_point(self) -> FloatArray:
        """(n,) Where each comes to rest when it brakes now, within the position limits."""
        distance = self.velocity * np.abs(self.velocity) / (2.0 * self._brake)
        return self._within_limits(self.position + distance)

    def _within_limits(self, position: FloatArray) -> FloatArray:
        """Positions within the limits, where those of what was found outside begin there."""
        lower, upper = np.minimum(self.limits.lower, self.position), np.maximum(self.limits.upper, self.position)
        within: FloatArray = np.maximum(np.minimum(position, upper), lower)
        return within

    def advance(self, target: FloatArray, target_velocity: FloatArray, dt: float) -> None:
        """Go one period towards a target.

        Args:
            target: (n,) where they shall be at the end of the period.
            target_velocity: (n,) how fast the target itself moves [1/s].
            dt: the period [s].
        """
        np.concatenate((target, target_velocity, self.position, self.velocity), out=self._asked.reshape(-1))
        if (asked := self._asked.tobytes()) == self._before and dt == self._dt[0]:
            return  # at rest on its target
        self._before = asked
        self._dt[0] = dt
        self._evaluate()
        self.position, self.velocity, self.acceleration = self._next.copy()

    def _expressions(self, asked: Expression, dt: Expression) -> Sequence[Expression]:
        target, target_velocity, now, before = (asked[i, :].T for i in range(4))
        limits = self.limits
        lower, upper, highest = ca.DM(limits.lower), ca.DM(limits.upper), ca.DM(limits.fastest)
        brake, step = ca.DM(self._brake), ca.DM(limits.acceleration) * dt
        half_step = 0.5 * dt * brake
        error = clipped(target, lower, upper) - target_velocity * dt - now
        distance = ca.fabs(error)
        # The greatest speed of approach from which braking in steps of dt still ends on the target.
        approach = ca.fmin(_braking_speed(distance, brake, half_step), distance / dt)
        velocity = target_velocity + ca.copysign(approach, error)
        # Likewise for the position limits.
        up = _braking_speed(ca.fmax(upper - now, 0.0), brake, half_step)
        down = _braking_speed(ca.fmax(now - lower, 0.0), brake, half_step)
        velocity = ca.fmin(ca.fmin(velocity, up), highest)
        velocity = ca.fmax(ca.fmax(velocity, -down), -highest)
        velocity = clipped(velocity, before - step, before + step)
        # A target that is no number must not become one on the way: who sends the command refuses it.
        velocity = ca.if_else(ca.fabs(error) < np.inf, velocity, np.nan)
        position = clipped(now + velocity * dt, ca.fmin(lower, now), ca.fmax(upper, now))
        velocity = (position - now) / dt
        return [ca.horzcat(position, velocity, (velocity - before) / dt).T]


def _braking_speed(distance: Expression, brake: Expression, half_step: Expression) -> Expression:
    """Greatest speed from which steps of equal deceleration cover no more than a distance.

    ``half_step`` is half of what one step brakes, a·Δt/2.

    v·(v + a·Δt) / (2a) = d, solved for v: the sum of v·Δt, (v − a·Δt)·Δt, … down to rest.
    """
    return ca.sqrt(half_step * half_step + 2.0 * brake * distance) - half_step
