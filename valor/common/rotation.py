"""Single rotations: quaternions (w, x, y, z) as tuples of floats, and (3, 3) matrices.

Functions on quaternions, and ``error``, also accept expressions of ``kernel``.
"""

from collections.abc import Iterable, Sequence
from math import asin, atan2, cos, sin, sqrt

import numpy as np

from valor.common.arrays import FloatArray

Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]

IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)
NORM = 1e-2  # tolerance of the norm of a goal's quaternion


def quaternion(values: Iterable[float]) -> Quaternion:
    """Four numbers as a unit quaternion. Raises ValueError if they are all zero, or not finite."""
    w, x, y, z = map(float, values)
    norm = sqrt(w * w + x * x + y * y + z * z)
    if not 1e-6 < norm < 1e6:
        raise ValueError(f"quaternion {(w, x, y, z)} has norm {norm}, expected 1")
    return w / norm, x / norm, y / norm, z / norm


def unit(a: Quaternion) -> Quaternion:
    """Normalise a quaternion of nearly unit norm."""
    w, x, y, z = a
    norm = (w * w + x * x + y * y + z * z) ** 0.5
    return w / norm, x / norm, y / norm, z / norm


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product a ⊗ b: first b, then a."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(a: Quaternion) -> Quaternion:
    """The inverse rotation."""
    return a[0], -a[1], -a[2], -a[3]


def rotate(a: Quaternion, v: Vector) -> Vector:
    """A vector rotated by a unit quaternion."""
    _, x, y, z = multiply(multiply(a, (0.0, *v)), conjugate(a))
    return x, y, z


def vertical(a: Quaternion) -> Vector:
    """The world's z axis in the frame with the attitude ``a``."""
    return rotate(conjugate(a), (0.0, 0.0, 1.0))


def small(x: float, y: float, z: float) -> Quaternion:
    """The rotation by a rotation vector [rad] of less than about 0.3 rad (error below 1e-5)."""
    x, y, z = 0.5 * x, 0.5 * y, 0.5 * z
    norm = (1.0 + x * x + y * y + z * z) ** 0.5
    return 1.0 / norm, x / norm, y / norm, z / norm


def about_z(angle: float) -> Quaternion:
    """The rotation about z by an angle [rad]."""
    return cos(0.5 * angle), 0.0, 0.0, sin(0.5 * angle)


def heading(a: Sequence[float]) -> float:
    """Heading of the x axis rotated by a unit quaternion [rad]."""
    w, x, y, z = a
    return atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def roll_pitch_yaw(a: Sequence[float]) -> tuple[float, float, float]:
    """Rotations of a unit quaternion about the fixed axes x, y, z, in order [rad]."""
    w, x, y, z = a
    sine = max(-1.0, min(1.0, 2.0 * (w * y - z * x)))
    return atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)), asin(sine), heading(a)


def rows(a: Quaternion) -> tuple[Vector, Vector, Vector]:
    """The (3, 3) rotation matrix of a unit quaternion."""
    w, x, y, z = a
    xx, yy, zz, xy, xz, yz, wx, wy, wz = x * x, y * y, z * z, x * y, x * z, y * z, w * x, w * y, w * z
    return (
        (1.0 - 2.0 * (yy + zz), 2.0 * (xy - wz), 2.0 * (xz + wy)),
        (2.0 * (xy + wz), 1.0 - 2.0 * (xx + zz), 2.0 * (yz - wx)),
        (2.0 * (xz - wy), 2.0 * (yz + wx), 1.0 - 2.0 * (xx + yy)),
    )


def matrix(a: Quaternion, out: FloatArray) -> None:
    """Write the (3, 3) rotation matrix of a unit quaternion into ``out``."""
    out[:] = rows(a)


def yaw(rotation: FloatArray) -> float:
    """Heading of a frame's x axis [rad]."""
    return atan2(rotation[1, 0], rotation[0, 0])


def mean_yaw(first: FloatArray, second: FloatArray) -> float:
    """Heading midway between two frames' x axes [rad]."""
    return atan2(first[1, 0] + second[1, 0], first[0, 0] + second[0, 0])


def yaw_matrix(angle: float) -> FloatArray:
    """(3, 3) rotation about z."""
    c, s = cos(angle), sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def from_roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> FloatArray:
    """(3, 3) R_z(yaw)·R_y(pitch)·R_x(roll)."""
    cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    return np.array(
        (
            (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
            (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
            (-sp, cp * sr, cp * cr),
        )
    )


def error(desired: FloatArray, actual: FloatArray) -> Vector:
    """The rotation from ``actual`` to ``desired`` in the axes both are given in: sin(θ)·axis [rad]."""
    e = desired @ actual.T
    return 0.5 * (e[2, 1] - e[1, 2]), 0.5 * (e[0, 2] - e[2, 0]), 0.5 * (e[1, 0] - e[0, 1])


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """(3,) a × b, twenty times as fast as NumPy's for single vectors."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx))


def rotation_vector(rotation: FloatArray) -> FloatArray:
    """(3,) axis·θ [rad] of a (3, 3) rotation below π (for setup, not for the loop)."""
    sine = np.array(error(rotation, np.eye(3)))
    norm = float(np.linalg.norm(sine))
    angle = atan2(norm, 0.5 * (float(np.trace(rotation)) - 1.0))
    return sine * (angle / norm) if norm > 1e-12 else sine


def from_rotation_vector(vector: FloatArray) -> FloatArray:
    """(3, 3) rotation by a rotation vector [rad] (Rodrigues)."""
    x, y, z = vector.tolist()
    angle = sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = x / angle, y / angle, z / angle
    s, c = sin(angle), cos(angle)
    t = 1.0 - c
    tx, ty, tz = t * x, t * y, t * z
    return np.array(
        (
            (c + tx * x, tx * y - s * z, tx * z + s * y),
            (tx * y + s * z, c + ty * y, ty * z - s * x),
            (tx * z - s * y, ty * z + s * x, c + tz * z),
        )
    )
