"""Limiter of command streams: continuous position and velocity, within all limits."""

from collections.abc import Sequence

import casadi as ca
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel, clipped
from valor.robot.commanded_limits import CommandedLimits

Joints = npt.NDArray[np.bool_]  # (n,) mask

BRAKE_FACTOR = 0.9  # share of the acceleration limit that braking is planned with


class Limiter:
    """Commanded positions that follow targets with limited velocity and acceleration, without overshoot.

    Commands stay within the position limits; a joint found outside returns from its position. ``position``,
    ``velocity`` and ``acceleration`` (n,) are commanded, in [rad] or [m].
    """

    def __init__(self, limits: CommandedLimits) -> None:
        """Start at rest at 0, or at the nearest limit."""
        n = len(limits.names)
        self.limits = limits
        self._brake: FloatArray = BRAKE_FACTOR * limits.acceleration
        self.position = limits.position_within(np.zeros(n))
        self.velocity = np.zeros(n)
        self.acceleration = np.zeros(n)
        self._asked, self._dt, self._next = np.zeros((4, n)), np.zeros(1), np.zeros((3, n))
        self._evaluate = Kernel("limiter", self._expressions, (self._asked, self._dt), (self._next,))
        self._before = b""  # last input; empty after a reset

    def reset(self, joints: Joints, position: FloatArray) -> None:
        """Reset the joints of a mask (n,) to rest at positions (n,)."""
        self._before = b""
        self.position = np.where(joints, position, self.position)
        self.velocity = np.where(joints, 0.0, self.velocity)
        self.acceleration = np.where(joints, 0.0, self.acceleration)

    def stopping_point(self) -> FloatArray:
        """Return the positions (n,) at which immediate braking ends, within the position limits."""
        distance = self.velocity * np.abs(self.velocity) / (2.0 * self._brake)
        lower, upper = np.minimum(self.limits.lower, self.position), np.maximum(self.limits.upper, self.position)
        within: FloatArray = np.maximum(np.minimum(self.position + distance, upper), lower)
        return within

    def advance(self, target: FloatArray, target_velocity: FloatArray, dt: float) -> None:
        """Advance one period [s] towards the target at its end (n,) and the target's velocity (n,) [1/s]."""
        np.concatenate((target, target_velocity, self.position, self.velocity), out=self._asked.reshape(-1))
        if (asked := self._asked.tobytes()) == self._before and dt == self._dt[0]:
            return  # at rest on the target
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
        # Largest approach velocity from which braking in steps of dt ends on the target.
        approach = ca.fmin(_braking_speed(distance, brake, half_step), distance / dt)
        velocity = target_velocity + ca.copysign(approach, error)
        # Likewise for the position limits.
        up = _braking_speed(ca.fmax(upper - now, 0.0), brake, half_step)
        down = _braking_speed(ca.fmax(now - lower, 0.0), brake, half_step)
        velocity = ca.fmin(ca.fmin(velocity, up), highest)
        velocity = ca.fmax(ca.fmax(velocity, -down), -highest)
        velocity = clipped(velocity, before - step, before + step)
        # NaN and inf must stay visible: the sender of the command rejects them.
        velocity = ca.if_else(ca.fabs(error) < np.inf, velocity, np.nan)
        position = clipped(now + velocity * dt, ca.fmin(lower, now), ca.fmax(upper, now))
        velocity = (position - now) / dt
        return [ca.horzcat(position, velocity, (velocity - before) / dt).T]


def _braking_speed(distance: Expression, brake: Expression, half_step: Expression) -> Expression:
    """Return the largest velocity from which discrete braking covers at most a distance.

    Solves v·(v + a·Δt) / (2a) = d, the sum of v·Δt, (v − a·Δt)·Δt, … down to rest; ``half_step`` is a·Δt/2.
    """
    return ca.sqrt(half_step * half_step + 2.0 * brake * distance) - half_step
