"""Orientation of the pelvis in odom: gyroscope and the IMU's own attitude.

A complementary filter (Mahony et al. 2008): the gyroscope is integrated and drawn towards the IMU's attitude. That has
two errors of its own, which last and are therefore kept beside it: its heading drifts, and its level is off by some
milliradians, fixed to the IMU. What they are is for others to tell (``turn_heading``, ``tilt``).
"""

from __future__ import annotations

from math import exp

from motion_manager.whole_body import rotation
from motion_manager.whole_body.rotation import Quaternion

Vector = tuple[float, float, float]

LARGEST_LEVEL = 0.03  # that an IMU's level is believed to be off about an axis [rad]


class Attitude:
    """Orientation of the pelvis in odom.

    Attributes:
        orientation: of the pelvis in odom.
    """

    def __init__(self, time_constant: float, imu_in_pelvis: Quaternion) -> None:
        """Upright.

        Args:
            time_constant: from the gyroscope to the IMU's attitude [s].
            imu_in_pelvis: how it is mounted.
        """
        self._time_constant = time_constant
        self._mounting = rotation.conjugate(imu_in_pelvis)
        self._heading = rotation.IDENTITY  # of odom from the IMU's world
        self._level = rotation.IDENTITY  # of the pelvis from where the IMU has it, in pelvis
        self._rate: Vector = (0.0, 0.0, 0.0)
        self._dt, self._gain = 0.0, 0.0
        self.orientation = rotation.IDENTITY

    def reset(self, imu_orientation: Quaternion, angular_velocity: Vector) -> None:
        """Take the IMU's attitude as it is."""
        self._heading = self._level = rotation.IDENTITY
        self._rate = angular_velocity
        self.orientation = rotation.multiply(imu_orientation, self._mounting)

    def turn(self, angle: float) -> None:
        """Turn the estimate and the heading about the vertical [rad]."""
        turned = rotation.about_z(angle)
        self._heading = rotation.multiply(turned, self._heading)
        self.orientation = rotation.multiply(turned, self.orientation)

    def turn_heading(self, angle: float) -> None:
        """Turn the heading alone by a small angle [rad]; the estimate follows with the filter."""
        self._heading = rotation.quaternion(rotation.multiply(rotation.small(0.0, 0.0, angle), self._heading))

    def tilt(self, vector: Vector) -> bool:
        """Turn the estimate, and the IMU's level in pelvis with it, by a small rotation vector in pelvis [rad].

        Returns:
            False: nothing was turned, for no IMU is so far from level.
        """
        turned = rotation.small(*vector)
        level = rotation.quaternion(rotation.multiply(self._level, turned))
        if 2.0 * max(abs(level[1]), abs(level[2])) > LARGEST_LEVEL:
            return False
        self._level = level
        self.orientation = rotation.multiply(self.orientation, turned)
        return True

    def update(self, imu_orientation: Quaternion, angular_velocity: Vector, dt: float) -> None:
        """Predict with the angular velocity in pelvis [rad/s] over ``dt`` [s], correct with the IMU's attitude."""
        if dt != self._dt:
            self._dt, self._gain = dt, 1.0 - exp(-dt / self._time_constant)
        (x, y, z), (px, py, pz) = angular_velocity, self._rate
        self._rate = angular_velocity
        half = 0.5 * dt  # trapezoids: the rate has been changing since the last period
        predicted = rotation.multiply(
            self.orientation, rotation.small(half * (x + px), half * (y + py), half * (z + pz))
        )
        mounted = rotation.multiply(rotation.multiply(imu_orientation, self._mounting), self._level)
        measured = rotation.multiply(self._heading, mounted)
        w, ex, ey, ez = rotation.multiply(rotation.conjugate(predicted), measured)
        gain = 2.0 * self._gain if w >= 0.0 else -2.0 * self._gain
        corrected = rotation.multiply(predicted, rotation.small(gain * ex, gain * ey, gain * ez))
        self.orientation = rotation.quaternion(corrected)
