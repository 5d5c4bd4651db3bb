"""Filters of the estimator, as expressions: attitude, contact of the feet, odometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from valor.common import rotation
from valor.common.kernel import Expression, by_rows
from valor.common.rotation import Quaternion, Vector
from valor.control.tuning_tables import Estimator
from valor.robot.tables import Foot

LARGEST_LEVEL = 0.03  # Largest accepted error of the IMU's level about an axis [rad]
ATTITUDE_SIZE = 15
SURPRISE_TIME = 0.02  # Averaging time of surprise, against noise [s]
LEAST = 0.05  # Least probability of a foot in contact
PAST_SIZE = 12
POSITION, VELOCITY, BIAS, FEET = 0, 1, 2, 3
SIZE = 5
MEASURES = 4  # positions of left and right sole from the pelvis, then pelvis velocity by left and right leg
NOTHING = 1e6  # variance of a measurement without information

_PLACES = np.zeros((MEASURES, SIZE))  # rows of the measurement matrix
_PLACES[[0, 1], POSITION] = -1.0
_PLACES[[0, 1], [FEET, FEET + 1]] = 1.0
_PLACES[2:, VELOCITY] = 1.0
MEASURED = ca.sparsify(ca.DM(_PLACES))


class Attitude(NamedTuple):
    """Orientation of the pelvis in odom, from the gyroscope and the IMU's attitude; floats or expressions.

    A complementary filter (Mahony et al. 2008): the gyroscope is integrated and drawn towards the IMU's attitude. That
    has two lasting errors, which are part of the state: its heading drifts, and its level is off by some milliradians,
    fixed to the IMU. Both are corrected from outside (``heading_turned``, ``tilted``).
    """

    orientation: Quaternion  # of the pelvis in odom
    heading: Quaternion = rotation.IDENTITY  # of odom from the IMU's world
    level: Quaternion = rotation.IDENTITY  # correction of the IMU's attitude, in pelvis
    rate: Vector = (0.0, 0.0, 0.0)  # of the pelvis in pelvis [rad/s]

    @classmethod
    def of(cls, numbers: Expression) -> Attitude:
        """Create from (15,) numbers, field by field."""
        n = [numbers[i] for i in range(ATTITUDE_SIZE)]
        return cls(
            (n[0], n[1], n[2], n[3]), (n[4], n[5], n[6], n[7]), (n[8], n[9], n[10], n[11]), (n[12], n[13], n[14])
        )

    @property
    def numbers(self) -> tuple[float, ...]:
        """(15,) numbers, field by field."""
        return (*self.orientation, *self.heading, *self.level, *self.rate)

    def updated(
        self, imu_orientation: Quaternion, rate: Vector, dt: float, time_constant: float, mounting: Quaternion
    ) -> Attitude:
        """Predict with the rate in pelvis [rad/s], correct with the attitude; ``mounting``: IMU in pelvis."""
        (x, y, z), (px, py, pz) = rate, self.rate
        half = 0.5 * dt  # trapezoidal rule
        turn = rotation.small(half * (x + px), half * (y + py), half * (z + pz))
        predicted = rotation.multiply(self.orientation, turn)
        pelvis = rotation.multiply(imu_orientation, rotation.conjugate(mounting))
        measured = rotation.multiply(self.heading, rotation.multiply(pelvis, self.level))
        w, ex, ey, ez = rotation.multiply(rotation.conjugate(predicted), measured)
        gain: Expression = 2.0 * (1.0 - ca.exp(-dt / time_constant)) * ca.if_else(w < 0.0, -1.0, 1.0)
        corrected = rotation.multiply(predicted, rotation.small(gain * ex, gain * ey, gain * ez))
        return self._replace(orientation=rotation.unit(corrected), rate=rate)

    def heading_turned(self, angle: float) -> Attitude:
        """Rotate only the heading, by a small angle [rad]; the filter makes the orientation follow."""
        turned = rotation.multiply(rotation.small(0.0, 0.0, angle), self.heading)
        return self._replace(heading=rotation.unit(turned))

    def tilted(self, vector: Vector) -> tuple[Attitude, Expression]:
        """Rotate by a small rotation vector in pelvis [rad] if within ``LARGEST_LEVEL``; return also whether."""
        turn = rotation.small(*vector)
        level = rotation.unit(rotation.multiply(self.level, turn))
        taken = 2.0 * ca.fmax(ca.fabs(level[1]), ca.fabs(level[2])) <= LARGEST_LEVEL
        tilted = self._replace(orientation=rotation.multiply(self.orientation, turn), level=level)
        return chosen(taken, tilted, self), taken


def chosen(condition: Expression, one: Attitude, other: Attitude) -> Attitude:
    """Return ``one`` if the condition holds, else ``other``."""
    pairs = zip(one.numbers, other.numbers, strict=True)
    return Attitude.of([ca.if_else(condition, a, b) for a, b in pairs])


class Past(NamedTuple):
    """State of a foot between periods, as expressions; all zero in the air."""

    touching: Expression  # whether it carried weight
    stood: Expression  # duration of contact [s]
    surprise: Expression  # squared, in standard deviations, averaged
    rotation: Expression  # (3, 3) of the sole in odom

    @classmethod
    def of(cls, numbers: Expression) -> Past:
        """Create from (12,) numbers, field by field, row by row."""
        return cls(numbers[0], numbers[1], numbers[2], by_rows(numbers[3:12]))

    @property
    def numbers(self) -> Expression:
        """(12,) numbers, field by field, row by row."""
        return ca.vertcat(self.touching, self.stood, self.surprise, ca.vec(self.rotation.T))


class FootContact(NamedTuple):
    """One foot in one period, in odom's axes, as expressions."""

    touching: Expression  # whether the foot carries weight, with hysteresis
    landed: Expression  # whether contact starts in this period
    probability: Expression  # that it stands still, 0 to 1
    force: Expression  # vertical [N]
    cop: Expression  # (3,) centre of pressure from the sole's origin [m]
    rolled: Expression  # (3,) motion of the sole's origin since the last period about a centre of pressure at rest [m]
    yaw: Expression  # of the sole [rad]
    past: Past  # for the next period


@dataclass(frozen=True, slots=True)
class FootSense:
    """Contact detection of a foot, from its wrench and from how well its leg agrees with the estimate."""

    foot: Foot  # its sole
    on: float  # vertical force above which the foot carries weight [N]
    off: float  # vertical force below which it does not [N]
    settling: float  # time from touchdown to rest [s]
    gate: float  # largest averaged squared surprise of a standing foot (standard deviations)

    def feel(
        self, past: Past, rotation: Expression, wrench: Expression, surprise: Expression, dt: Expression
    ) -> FootContact:
        """Return the foot after ``dt`` [s], from its ``past``; ``rotation`` in odom, (6,) ``wrench`` in the sole."""
        fz, tx, ty = wrench[2], wrench[3], wrench[4]
        force = (rotation @ wrench[:3])[2]
        touching = force >= ca.if_else(past.touching, self.off, self.on)
        pressed = fz > self.off
        foot = self.foot
        x = ca.if_else(pressed, ca.fmin(ca.fmax(-ty / fz, foot.heel), foot.toe), 0.0)
        y = ca.if_else(pressed, ca.fmin(ca.fmax(tx / fz, -foot.half_width), foot.half_width), 0.0)
        place = ca.vertcat(x, y, 0.0)
        stood = ca.if_else(past.touching, past.stood + dt, 0.0)
        averaged = past.surprise + (surprise - past.surprise) * ca.fmin(1.0, dt / SURPRISE_TIME)
        loaded = ca.fmin(1.0, (force - self.off) / (self.on - self.off))
        still = ca.fmin(1.0, self.gate / ca.fmax(averaged, 1e-9)) ** 2
        settled = ca.fmin(1.0, stood / self.settling)
        return FootContact(
            touching=touching,
            landed=ca.logic_and(touching, ca.logic_not(past.touching)),
            probability=ca.if_else(touching, ca.fmax(LEAST, loaded * settled * still), 0.0),
            force=force,
            cop=rotation @ place,
            rolled=(past.rotation - rotation) @ place,
            yaw=ca.atan2(rotation[1, 0], rotation[0, 0]),
            past=Past(touching, ca.if_else(touching, stood, 0.0), ca.if_else(touching, averaged, 0.0), rotation),
        )


class Odometry(NamedTuple):
    """Position and velocity of the pelvis and of the footholds: a Kalman filter (Bloesch et al. 2012).

    The accelerometer predicts the pelvis; a foot on the ground stays, so its leg measures the pelvis position relative
    to it and the pelvis velocity. The footholds are part of the state: a foot enters at touchdown with the uncertainty
    of the pelvis, which therefore grows from foothold to foothold, as the error of odometry does. Given the attitude,
    the axes of odom are independent and have one covariance: 5×5.

        x = (p, v, b, f_left, f_right)      b: the accelerometer's error
        p⁺ = p + v·dt + ½(a − b)·dt²,  v⁺ = v + (a − b)·dt,  b⁺ = b,  f⁺ = f + rolling of the foot
        each leg measures f − p and v

    The errors of the four measurements are independent, so they are applied in turn, without a matrix inverse.
    """

    state: Expression
    """(5, 3) rows position [m], velocity [m/s], accelerometer's error [m/s²], left and right sole [m]; columns x, y, z
    in odom."""
    covariance: Expression  # (5, 5) of the rows, the same on each axis
    acceleration: Expression  # (3,) of the last period, in odom [m/s²]

    def placed(self, foot: int, landed: Expression, sole: Expression, variance: float) -> Odometry:
        """Set the foothold of a landed foot (0 left, 1 right) to (3,) its sole from the pelvis [m], variance [m²]."""
        row = FEET + foot
        copy = ca.DM.eye(SIZE)  # the foot's row is the pelvis row plus the sole
        copy[row, row], copy[row, POSITION] = 0.0, 1.0
        copy = ca.sparsify(copy)
        state, covariance = copy @ self.state, copy @ self.covariance @ copy.T
        state[row, :] += sole.T
        covariance[row, row] += variance
        return self._replace(
            state=ca.if_else(landed, state, self.state),
            covariance=ca.if_else(landed, covariance, self.covariance),
        )

    def predicted(
        self, acceleration: Expression, dt: Expression, wander: tuple[Expression, Expression], table: Estimator
    ) -> Odometry:
        """Predict by ``dt`` [s], (3,) acceleration in odom [m/s²]; ``wander``: growth of foothold variances [m²/s]."""
        transition, gain = ca.SX.eye(SIZE), ca.SX(SIZE, 1)
        gain[POSITION], gain[VELOCITY] = 0.5 * dt * dt, dt
        transition[POSITION, VELOCITY] = dt
        transition[POSITION, BIAS], transition[VELOCITY, BIAS] = -gain[POSITION], -dt
        mean = 0.5 * (acceleration + self.acceleration)  # trapezoidal rule
        process = gain @ gain.T * table.acceleration_deviation**2
        process[BIAS, BIAS] = table.bias_walk**2 * dt
        for foot in range(2):
            process[FEET + foot, FEET + foot] = wander[foot] * dt
        return Odometry(
            transition @ self.state + gain @ mean.T,
            transition @ self.covariance @ transition.T + process,
            acceleration,
        )

    def surprise(self, measured: Expression, variances: Expression) -> list[Expression]:
        """Return each leg's larger normalised squared innovation, from (4, 3) ``measured`` as ``MEASURES``."""
        innovation = measured - MEASURED @ self.state
        spread = ca.diag(MEASURED @ self.covariance @ MEASURED.T) + variances
        squares = ca.sum2(innovation**2) / (3.0 * spread)
        return [ca.fmax(squares[foot], squares[2 + foot]) for foot in range(2)]

    def corrected(self, measured: Expression, variances: Expression) -> Odometry:
        """Correct with the measurements of the legs; arguments as of ``surprise``."""
        state, covariance = self.state, self.covariance
        for i in range(MEASURES):
            row = MEASURED[i, :]
            gain = covariance @ row.T
            spread = row @ gain + variances[i]
            state = state + gain @ ((measured[i, :] - row @ state) / spread)
            covariance = covariance - gain @ gain.T / spread
        return self._replace(state=state, covariance=covariance)

    def faded(self, dt: Expression, time_constant: float) -> Odometry:
        """Fade the velocity while no foot on the ground corrects it."""
        left = ca.SX.eye(SIZE)
        left[VELOCITY, VELOCITY] = ca.exp(-dt / time_constant)
        return self._replace(state=left @ self.state, covariance=left @ self.covariance @ left.T)
