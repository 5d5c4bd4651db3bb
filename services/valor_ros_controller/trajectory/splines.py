"""Splines between states, and whether they keep within limits."""

from __future__ import annotations

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits, Indices
from valor.valor_ros_controller.trajectory.errors import ErrorCode, InvalidTrajectoryError

_SAMPLES = 33  # a segment is looked at in so many places when its limits are checked
_CHUNK = 64  # segments at a time: bounds the memory of the check


def spline(
    start: tuple[FloatArray, FloatArray, FloatArray],
    end: tuple[FloatArray, FloatArray, FloatArray],
    duration: FloatArray,
    order: Indices,
) -> FloatArray:
    """Coefficients of the polynomials between pairs of states (position, velocity, acceleration).

    Args:
        start: (k, m) each.
        end: (k, m) each.
        duration: (k,) [s], positive.
        order: (k,) 1 linear, 3 cubic, 5 quintic; what is not met by the order is ignored.

    Returns:
        (k, 6, m) lowest power first, in time since the segment began [s].
    """
    (p0, v0, a0), (p1, v1, a1) = start, end
    T = duration[:, None]
    c = np.zeros((len(duration), 6, p0.shape[1]))
    with np.errstate(all="ignore"):  # what overflows is found by the limits
        distance = p1 - p0
        c[:, 0] = p0
        linear, cubic, quintic = order == 1, order == 3, order == 5
        c[linear, 1] = (distance / T)[linear]
        c[cubic, 1] = v0[cubic]
        c[cubic, 2] = ((3 * distance - (2 * v0 + v1) * T) / T**2)[cubic]
        c[cubic, 3] = ((-2 * distance + (v0 + v1) * T) / T**3)[cubic]
        c[quintic, 1] = v0[quintic]
        c[quintic, 2] = (0.5 * a0)[quintic]
        c[quintic, 3] = ((20 * distance - (12 * v0 + 8 * v1) * T - (3 * a0 - a1) * T**2) / (2 * T**3))[quintic]
        c[quintic, 4] = ((-30 * distance + (16 * v0 + 14 * v1) * T + (3 * a0 - 2 * a1) * T**2) / (2 * T**4))[quintic]
        c[quintic, 5] = ((12 * distance - 6 * (v0 + v1) * T - (a0 - a1) * T**2) / (2 * T**5))[quintic]
    return c


def _powers(time: FloatArray) -> FloatArray:
    """(3, …, 6) powers of time for position, and their derivatives for velocity and acceleration."""
    ones = np.ones_like(time)
    none = 0.0 * time
    position = np.stack([ones, time, time**2, time**3, time**4, time**5], axis=-1)
    velocity = np.stack([none, ones, 2 * time, 3 * time**2, 4 * time**3, 5 * time**4], axis=-1)
    acceleration = np.stack([none, none, 2 * ones, 6 * time, 12 * time**2, 20 * time**3], axis=-1)
    return np.stack([position, velocity, acceleration])


def check_segments(
    coefficients: FloatArray,
    duration: FloatArray,
    limits: CommandedLimits,
    describe: str = "between points {0} and {1}",
) -> tuple[FloatArray, FloatArray]:
    """Whether splines keep within the limits of position and speed everywhere.

    Args:
        coefficients: (k, 6, m).
        duration: (k,) [s].
        limits: of the m joints.
        describe: where a segment is, for the error's text; takes its number and the next.

    Returns:
        (m,) greatest speed [1/s] and acceleration [1/s²] of each joint.

    Raises:
        InvalidTrajectoryError: they do not.
    """
    fractions = np.linspace(0.0, 1.0, _SAMPLES)
    most = np.zeros((2, len(limits.names)))
    for first in range(0, len(duration), _CHUNK):
        with np.errstate(all="ignore"):
            powers = _powers(duration[first : first + _CHUNK, None] * fractions)
            positions, *rates = powers @ coefficients[first : first + _CHUNK]  # (k, samples, m) each
            speeds, accelerations = (np.abs(rate).max(axis=1) for rate in rates)
        # Written so that NaN fails.
        if not (fast := speeds <= limits.fastest).all():
            segment, joint = np.argwhere(~fast)[0]
            where, unit = describe.format(first + segment, first + segment + 1), limits.units[joint]
            raise InvalidTrajectoryError(
                ErrorCode.INVALID_GOAL,
                f"{limits.names[joint]} would move at {speeds[segment, joint]:.3g} {unit}/s {where}; "
                f"its limit is {limits.velocity[joint]:g} {unit}/s",
            )
        inside = (positions >= limits.lower - 1e-6) & (positions <= limits.upper + 1e-6)
        if not inside.all():
            segment, _, joint = np.argwhere(~inside)[0]
            worst = positions[segment, :, joint]
            value = worst.max() if worst.max() > limits.upper[joint] else worst.min()
            where, unit = describe.format(first + segment, first + segment + 1), limits.units[joint]
            raise InvalidTrajectoryError(
                ErrorCode.INVALID_GOAL,
                f"{limits.names[joint]} would reach {value:.4g} {unit} {where}; "
                f"its limits are {limits.lower[joint]:g} to {limits.upper[joint]:g} {unit}",
            )
        most = np.maximum(most, [speeds.max(axis=0), accelerations.max(axis=0)])
    return most[0], most[1]
