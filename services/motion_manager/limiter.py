"""Makes any stream of joint targets safe to follow: no jump in position, none in velocity, no limit passed."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from valor_common.robot import FloatVector, RobotDescription

VELOCITY_FACTOR = 0.8  # of a joint's velocity limit: room for its servo to catch up
ACCELERATION_TIME = 0.1  # from rest to a joint's velocity limit [s]; robots publish no acceleration limits
BRAKE_FACTOR = 0.9  # of the acceleration, that braking is planned with


class JointLimiter:
    """The commanded position of every joint, which follows a target with limited velocity and acceleration.

    A target that keeps the limits is followed exactly, one that does not as fast as the limits allow, without
    overshoot. What is commanded stays within the position limits; a joint found outside them comes in from there.

    Attributes:
        position: (n,) commanded [rad].
        velocity: (n,) commanded [rad/s].
        acceleration: (n,) commanded [rad/s²].
        velocity_limit: (n,) [rad/s].
        acceleration_limit: (n,) [rad/s²].
    """

    def __init__(self, robot: RobotDescription) -> None:
        n = len(robot.joints)
        self._lower, self._upper = robot.lower, robot.upper
        self.velocity_limit: FloatVector = VELOCITY_FACTOR * robot.velocity_limit
        self.acceleration_limit: FloatVector = robot.velocity_limit / ACCELERATION_TIME
        self._brake: FloatVector = BRAKE_FACTOR * self.acceleration_limit
        self.position = np.clip(np.zeros(n), robot.lower, robot.upper)
        self.velocity = np.zeros(n)
        self.acceleration = np.zeros(n)

    def reset(self, joints: npt.NDArray[np.bool_], position: FloatVector) -> None:
        """Take joints up, at rest, where they are found.

        Args:
            joints: (n,) which ones.
            position: (n,) [rad].
        """
        self.position = np.where(joints, position, self.position)
        self.velocity = np.where(joints, 0.0, self.velocity)
        self.acceleration = np.where(joints, 0.0, self.acceleration)

    def stopping_point(self) -> FloatVector:
        """(n,) Where each joint comes to rest when it brakes now, within the position limits [rad]."""
        distance = self.velocity * np.abs(self.velocity) / (2.0 * self._brake)
        return self._within_limits(self.position + distance)

    def _within_limits(self, position: FloatVector) -> FloatVector:
        """Positions within the limits, where those of joints found outside begin at the joint itself."""
        lower, upper = np.minimum(self._lower, self.position), np.maximum(self._upper, self.position)
        within: FloatVector = np.maximum(np.minimum(position, upper), lower)
        return within

    def advance(self, target: FloatVector, target_velocity: FloatVector, dt: float) -> None:
        """Go one period towards a target.

        Args:
            target: (n,) where the joints shall be at the end of the period [rad].
            target_velocity: (n,) how fast the target itself moves [rad/s].
            dt: the period [s].
        """
        # np.minimum and np.maximum: np.clip costs five times as much on vectors this short.
        brake, half_step, now = self._brake, (0.5 * dt) * self._brake, self.position
        target = np.maximum(np.minimum(target, self._upper), self._lower)
        error = target - target_velocity * dt - now
        distance = np.abs(error)
        # The greatest speed of approach from which braking in steps of dt still ends on the target.
        approach = np.minimum(_braking_speed(distance, brake, half_step), distance / dt)
        velocity = target_velocity + np.copysign(approach, error)
        # Likewise for the position limits.
        up = _braking_speed(np.maximum(self._upper - now, 0.0), brake, half_step)
        down = _braking_speed(np.maximum(now - self._lower, 0.0), brake, half_step)
        highest, step = self.velocity_limit, self.acceleration_limit * dt
        velocity = np.minimum(np.minimum(velocity, up), highest)
        velocity = np.maximum(np.maximum(velocity, -down), -highest)
        velocity = np.maximum(np.minimum(velocity, self.velocity + step), self.velocity - step)
        position = self._within_limits(now + velocity * dt)
        velocity = (position - now) / dt
        self.acceleration = (velocity - self.velocity) / dt
        self.position, self.velocity = position, velocity


def _braking_speed(distance: FloatVector, brake: FloatVector, half_step: FloatVector) -> FloatVector:
    """Greatest speed from which steps of equal deceleration cover no more than a distance.

    ``half_step`` is half of what one step brakes, a·Δt/2.

    v·(v + a·Δt) / (2a) = d, solved for v: the sum of v·Δt, (v − a·Δt)·Δt, … down to rest.
    """
    speed: FloatVector = np.sqrt(half_step * half_step + 2.0 * brake * distance) - half_step
    return speed
