"""Orientation of the pelvis in odom: gyroscope and the IMU's own attitude.

A complementary filter (Mahony et al. 2008): the gyroscope is integrated and drawn towards the IMU's attitude. That has
two errors of its own, which last and are therefore kept beside it: its heading drifts, and its level is off by some
milliradians, fixed to the IMU. What they are is for others to tell (``heading_turned``, ``tilted``).
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from valor.common import rotation
from valor.common.kernel import Expression
from valor.common.rotation import Quaternion, Vector

LARGEST_LEVEL = 0.03  # that an IMU's level is believed to be off about an axis [rad]
SIZE = 15


class Attitude(NamedTuple):
    """What is known, as floats or as expressions."""

    orientation: Quaternion  # of the pelvis in odom
    heading: Quaternion = rotation.IDENTITY  # of odom from the IMU's world
    level: Quaternion = rotation.IDENTITY  # of the pelvis from where the IMU has it, in pelvis
    rate: Vector = (0.0, 0.0, 0.0)  # of the pelvis in pelvis [rad/s]

    @classmethod
    def of(cls, numbers: Expression) -> Attitude:
        """From (15,) numbers, one field after another."""
        n = [numbers[i] for i in range(SIZE)]
        return cls(
            (n[0], n[1], n[2], n[3]), (n[4], n[5], n[6], n[7]), (n[8], n[9], n[10], n[11]), (n[12], n[13], n[14])
        )

    @property
    def numbers(self) -> tuple[float, ...]:
        """(15,) numbers, one field after another."""
        return (*self.orientation, *self.heading, *self.level, *self.rate)

    def updated(
        self, imu_orientation: Quaternion, rate: Vector, dt: float, time_constant: float, mounting: Quaternion
    ) -> Attitude:
        """Predicted with the angular velocity, corrected with the IMU's attitude.

        Args:
            imu_orientation: in the IMU's world.
            rate: angular velocity in pelvis [rad/s].
            dt: since the last period [s].
            time_constant: from the gyroscope to the IMU's attitude [s].
            mounting: of the IMU in pelvis.
        """
        (x, y, z), (px, py, pz) = rate, self.rate
        half = 0.5 * dt  # trapezoids: the rate has been changing since the last period
        turn = rotation.small(half * (x + px), half * (y + py), half * (z + pz))
        predicted = rotation.multiply(self.orientation, turn)
        pelvis = rotation.multiply(imu_orientation, rotation.conjugate(mounting))
        measured = rotation.multiply(self.heading, rotation.multiply(pelvis, self.level))
        w, ex, ey, ez = rotation.multiply(rotation.conjugate(predicted), measured)
        gain: Expression = 2.0 * (1.0 - ca.exp(-dt / time_constant)) * ca.if_else(w < 0.0, -1.0, 1.0)
        corrected = rotation.multiply(predicted, rotation.small(gain * ex, gain * ey, gain * ez))
        return self._replace(orientation=rotation.unit(corrected), rate=rate)

    def heading_turned(self, angle: float) -> Attitude:
        """The heading turned alone, by a small angle [rad]; the orientation follows with the filter."""
        turned = rotation.multiply(rotation.small(0.0, 0.0, angle), self.heading)
        return self._replace(heading=rotation.unit(turned))

    def tilted(self, vector: Vector) -> tuple[Attitude, Expression]:
        """The orientation turned, and the IMU's level with it, by a small rotation vector in pelvis [rad].

        Returns:
            The attitude; and whether it was turned, for no IMU is further from level than ``LARGEST_LEVEL``.
        """
        turn = rotation.small(*vector)
        level = rotation.unit(rotation.multiply(self.level, turn))
        taken = 2.0 * ca.fmax(ca.fabs(level[1]), ca.fabs(level[2])) <= LARGEST_LEVEL
        tilted = self._replace(orientation=rotation.multiply(self.orientation, turn), level=level)
        return chosen(taken, tilted, self), taken


def chosen(condition: Expression, one: Attitude, other: Attitude) -> Attitude:
    """``one`` where the condition holds, or ``other``."""
    pairs = zip(one.numbers, other.numbers, strict=True)
    return Attitude.of([ca.if_else(condition, a, b) for a, b in pairs])
