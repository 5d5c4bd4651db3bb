"""Position and velocity of the pelvis, and where the feet stand: a Kalman filter (Bloesch et al. 2012).

The accelerometer moves the pelvis; a foot on the ground stays where it is, so that its leg measures the pelvis' place
from it, and the pelvis' velocity. Where each foot stands is part of the state: a foot comes in where it touches down,
with the pelvis' own uncertainty, which therefore grows from foothold to foothold, as odometry's error does. Given the
attitude, the axes of odom do not mix, and all three have one covariance: 5×5.

    x = (p, v, b, f_left, f_right)      b: the accelerometer's error
    p⁺ = p + v·dt + ½(a − b)·dt²,  v⁺ = v + (a − b)·dt,  b⁺ = b,  f⁺ = f + what the foot rolls
    each leg measures f − p and v

The errors of the four measurements do not depend on each other, so they are taken one after another, which needs no
matrix inverted.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from valor.common.kernel import Expression
from valor.whole_body.tuning_tables import Estimator

POSITION, VELOCITY, BIAS, FEET = 0, 1, 2, 3
SIZE = 5
MEASURES = 4  # places of the soles from the pelvis, left and right, then the pelvis' velocity, by left and right leg
NOTHING = 1e6  # variance of a measurement that says nothing

_PLACES = np.zeros((MEASURES, SIZE))  # what each measures of the state
_PLACES[[0, 1], POSITION] = -1.0
_PLACES[[0, 1], [FEET, FEET + 1]] = 1.0
_PLACES[2:, VELOCITY] = 1.0
MEASURED = ca.sparsify(ca.DM(_PLACES))


class Odometry(NamedTuple):
    """The filter's state, as expressions."""

    state: Expression
    """(5, 3) rows position [m], velocity [m/s], accelerometer's error [m/s²], left and right sole [m]; columns x, y, z
    in odom."""
    covariance: Expression  # (5, 5) of the rows, the same on each axis
    acceleration: Expression  # (3,) of the last period, in odom [m/s²]

    def placed(self, foot: int, landed: Expression, sole: Expression, variance: float) -> Odometry:
        """If a foot has landed it is somewhere else.

        Args:
            foot: 0 left, 1 right.
            landed: whether.
            sole: (3,) from the pelvis, in odom's axes [m].
            variance: of that [m²].
        """
        row = FEET + foot
        copy = ca.DM.eye(SIZE)  # the foot's row is the pelvis', and what the sole adds
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
        """Gone on in time.

        Args:
            acceleration: (3,) now, in odom [m/s²].
            dt: since the last [s].
            wander: how much variance each foot's place gains a second [m²/s].
            table: of the errors' sizes.
        """
        transition, gain = ca.SX.eye(SIZE), ca.SX(SIZE, 1)
        gain[POSITION], gain[VELOCITY] = 0.5 * dt * dt, dt
        transition[POSITION, VELOCITY] = dt
        transition[POSITION, BIAS], transition[VELOCITY, BIAS] = -gain[POSITION], -dt
        mean = 0.5 * (acceleration + self.acceleration)  # trapezoids
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
        """How far each leg's measurement is from what is expected of it.

        Args:
            measured: (4, 3) places of the soles [m] and velocities of the pelvis [m/s], as above, in odom's axes.
            variances: (4,) of the rows; ``NOTHING`` where one says nothing.

        Returns:
            (2,) squares, in standard deviations, mean of three axes; the larger one of place and velocity.
        """
        innovation = measured - MEASURED @ self.state
        spread = ca.diag(MEASURED @ self.covariance @ MEASURED.T) + variances
        squares = ca.sum2(innovation**2) / (3.0 * spread)
        return [ca.fmax(squares[foot], squares[2 + foot]) for foot in range(2)]

    def corrected(self, measured: Expression, variances: Expression) -> Odometry:
        """Corrected with what the legs measure; arguments as of ``surprise``."""
        state, covariance = self.state, self.covariance
        for i in range(MEASURES):
            row = MEASURED[i, :]
            gain = covariance @ row.T
            spread = row @ gain + variances[i]
            state = state + gain @ ((measured[i, :] - row @ state) / spread)
            covariance = covariance - gain @ gain.T / spread
        return self._replace(state=state, covariance=covariance)

    def faded(self, dt: Expression, time_constant: float) -> Odometry:
        """No foot is on the ground: the velocity fades, for nothing corrects it."""
        left = ca.SX.eye(SIZE)
        left[VELOCITY, VELOCITY] = ca.exp(-dt / time_constant)
        return self._replace(state=left @ self.state, covariance=left @ self.covariance @ left.T)
