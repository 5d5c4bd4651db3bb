"""Rotations as expressions, beside what ``valor.common.rotation`` does to floats and expressions alike."""

from __future__ import annotations

import casadi as ca
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression


def turned(vector: Expression) -> Expression:
    """(3, 3) rotation by a rotation vector [rad] (Rodrigues)."""
    angle = ca.fmax(ca.norm_2(vector), 1e-12)
    cross = ca.skew(vector / angle)
    return ca.SX.eye(3) + ca.sin(angle) * cross + (1.0 - ca.cos(angle)) * (cross @ cross)


def about(axis: FloatArray, angle: Expression) -> Expression:
    """(3, 3) rotation about an axis (3,) of length one by an angle [rad] (Rodrigues)."""
    x = ca.sparsify(ca.DM(np.cross(axis, np.eye(3)).T))
    return ca.SX.eye(3) + ca.sin(angle) * x + (1.0 - ca.cos(angle)) * (x @ x)


def rotation_vector(turn: Expression) -> Expression:
    """(3,) [rad] as ``rotation.rotation_vector``."""
    sine = 0.5 * ca.vertcat(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1])
    norm = ca.norm_2(sine)
    return sine * (ca.atan2(norm, 0.5 * (ca.trace(turn) - 1.0)) / ca.fmax(norm, 1e-12))


def roll_pitch_yaw(matrix: Expression) -> tuple[Expression, Expression, Expression]:
    """The inverse of ``from_roll_pitch_yaw``, of a (3, 3) expression, for a pitch below π/2 [rad]."""
    forward = ca.norm_2(matrix[:2, 0])
    return (
        ca.atan2(matrix[2, 1], matrix[2, 2]),
        ca.atan2(-matrix[2, 0], forward),
        ca.atan2(matrix[1, 0], matrix[0, 0]),
    )
