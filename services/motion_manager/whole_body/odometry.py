"""Position and velocity of the pelvis, and where the feet stand: a Kalman filter (Bloesch et al. 2012).

The accelerometer moves the pelvis; a foot on the ground stays where it is, so that its leg measures the pelvis' place
from it, and the pelvis' velocity. Where each foot stands is part of the state: a foot comes in where it touches down,
with the pelvis' own uncertainty, which therefore grows from foothold to foothold, as odometry's error does. Given the
attitude, the axes of odom do not mix, and all three have one covariance: 5×5.

    x = (p, v, b, f_left, f_right)      b: the accelerometer's error
    p⁺ = p + v·dt + ½(a − b)·dt²,  v⁺ = v + (a − b)·dt,  b⁺ = b,  f⁺ = f + what the foot rolls
    each leg measures f − p and v
"""

from __future__ import annotations

from math import exp

import numpy as np
from scipy.linalg.lapack import dposv

from motion_manager.whole_body.state import FloatArray
from valor_common.robot import Estimator

POSITION, VELOCITY, BIAS, FEET = 0, 1, 2, 3
SIZE = 5
MEASURES = 4  # places of the soles from the pelvis, left and right, then the pelvis' velocity, by left and right leg
_MEAN = np.full(3, 1.0 / 3.0)
NOTHING = 1e6  # variance of a measurement that says nothing


class OdometryFilter:
    """The filter.

    Attributes:
        state: (5, 3) rows position [m], velocity [m/s], accelerometer's error [m/s²], left and right sole [m]; columns
            x, y, z in odom.
        covariance: (5, 5) of the rows, the same on each axis.
        surprise: (2,) squares of how far each leg's last measurement was from what was expected of it, in its standard
            deviations, mean of three axes; the larger one of place and velocity.
    """

    def __init__(self, table: Estimator) -> None:
        self._table = table
        self._dt = 0.0
        self._transition = np.eye(SIZE)
        self._input = np.zeros((SIZE, 1))
        self._process = np.zeros((SIZE, SIZE))
        self._measures = np.zeros((MEASURES, SIZE))
        self._measures[0, [POSITION, FEET]] = -1.0, 1.0
        self._measures[1, [POSITION, FEET + 1]] = -1.0, 1.0
        self._measures[2:, VELOCITY] = 1.0
        self._measures_t = self._measures.T.copy()
        self._acceleration = np.zeros(3)
        self.state = np.zeros((SIZE, 3))
        self.covariance = np.zeros((SIZE, SIZE))
        self.surprise = [0.0, 0.0]

    def reset(self, position: FloatArray, soles: FloatArray, acceleration: FloatArray) -> None:
        """Stand still.

        Args:
            position: (3,) of the pelvis in odom [m].
            soles: (2, 3) from the pelvis, in odom's axes [m].
            acceleration: (3,) as measured, in odom [m/s²].
        """
        table = self._table
        self.state[:] = 0.0
        self.state[POSITION] = position
        self.state[FEET:] = position + soles
        self._acceleration = acceleration
        leg = table.leg_position_deviation**2
        self.covariance = np.diag((0.0, table.start_velocity_deviation**2, table.bias_deviation**2, leg, leg))
        self.surprise = [0.0, 0.0]

    def predict(self, acceleration: FloatArray, dt: float, wander: tuple[float, float]) -> None:
        """Go on in time.

        Args:
            acceleration: (3,) now, in odom [m/s²].
            dt: since the last [s].
            wander: how much variance each foot's place gains a second [m²/s].
        """
        if dt != self._dt:
            self._set_period(dt)
        state, transition = self._transition @ self.state, self._transition
        mean = acceleration + self._acceleration  # trapezoids
        mean *= 0.5
        state += self._input * mean
        self.state, self._acceleration = state, acceleration
        covariance = transition @ self.covariance @ transition.T
        covariance += self._process
        covariance[3, 3] += wander[0] * dt
        covariance[4, 4] += wander[1] * dt
        self.covariance = covariance

    def _set_period(self, dt: float) -> None:
        table = self._table
        self._dt = dt
        self._transition[POSITION, VELOCITY] = dt
        self._transition[POSITION, BIAS] = -0.5 * dt * dt
        self._transition[VELOCITY, BIAS] = -dt
        self._input[:2, 0] = 0.5 * dt * dt, dt
        self._process = self._input @ self._input.T * table.acceleration_deviation**2
        self._process[BIAS, BIAS] = table.bias_walk**2 * dt

    def place(self, foot: int, sole: FloatArray, variance: float) -> None:
        """A foot is somewhere else: (3,) its sole from the pelvis, in odom's axes [m], and with what variance [m²]."""
        row, covariance = FEET + foot, self.covariance
        self.state[row] = self.state[POSITION] + sole
        covariance[row] = covariance[POSITION]
        covariance[:, row] = covariance[:, POSITION]
        covariance[row, row] = covariance[POSITION, POSITION] + variance
        self.surprise[foot] = 0.0

    def correct(self, measured: FloatArray, variances: FloatArray) -> None:
        """Correct with what the legs measure.

        Args:
            measured: (4, 3) rows as ``MEASURES`` [m, m/s], in odom's axes.
            variances: (4,) of the rows; ``NOTHING`` where one says nothing.
        """
        innovation = measured - self._measures @ self.state
        gain_t = self._measures @ self.covariance  # of the innovations with the state
        spread = gain_t @ self._measures_t
        diagonal = spread.ravel()[:: MEASURES + 1]  # a view
        diagonal += variances
        innovation_squared = innovation * innovation
        left, right, left_rate, right_rate = (innovation_squared @ _MEAN / diagonal).tolist()
        self.surprise = [max(left, left_rate), max(right, right_rate)]
        _, gain_transposed, info = dposv(spread, gain_t, lower=1)
        if info:
            return
        self.state += gain_transposed.T @ innovation
        self.covariance -= gain_t.T @ gain_transposed

    def fade(self, dt: float) -> None:
        """No foot is on the ground: let the velocity fade, for nothing corrects it."""
        left = exp(-dt / self._table.hang_time_constant)
        self.state[VELOCITY] *= left
        self.covariance[VELOCITY] *= left
        self.covariance[:, VELOCITY] *= left
