"""Poses of one frame in another as Python floats, faster than NumPy for single poses."""

from __future__ import annotations

import math
from dataclasses import dataclass

from valor.common.rotation import Quaternion, Vector, about_z, conjugate, heading, multiply, rotate, rows, unit


@dataclass(frozen=True, slots=True)
class Pose:
    """Pose of a frame in another; ``outer @ inner`` chains poses."""

    position: Vector = (0.0, 0.0, 0.0)  # [m]
    orientation: Quaternion = (1.0, 0.0, 0.0, 0.0)  # of norm 1

    def __matmul__(self, inner: Pose) -> Pose:
        x, y, z = rotate(self.orientation, inner.position)
        px, py, pz = self.position
        return Pose((px + x, py + y, pz + z), unit(multiply(self.orientation, inner.orientation)))

    def inverse(self) -> Pose:
        """Pose of the other frame in this one."""
        back = conjugate(self.orientation)
        px, py, pz = self.position
        return Pose(rotate(back, (-px, -py, -pz)), back)

    @property
    def rotation(self) -> tuple[Vector, Vector, Vector]:
        """Rows of the rotation matrix."""
        return rows(self.orientation)

    @property
    def yaw(self) -> float:
        """Heading of the frame's x axis [rad]."""
        return heading(self.orientation)

    @property
    def tilt(self) -> float:
        """Angle between the z axes [rad]."""
        _, x, y, _ = self.orientation
        return math.acos(max(-1.0, 1.0 - 2.0 * (x * x + y * y)))

    def plane_to(self, other: Pose) -> Pose:
        """Displacement, with a rotation about z only, from this pose's position and heading to the other's.

        Both poses and the displacement are in one frame; the tilt does not change.
        """
        turn = about_z(other.yaw - self.yaw)
        x, y, z = rotate(turn, self.position)
        ox, oy, oz = other.position
        return Pose((ox - x, oy - y, oz - z), turn)


def level(x: float, y: float, z: float, yaw: float) -> Pose:
    """An upright frame [m, rad]."""
    return Pose((x, y, z), about_z(yaw))


def middle(left: Pose, right: Pose) -> Pose:
    """The level pose midway between two soles, with the mean of their headings."""
    x, y, z = ((a + b) / 2.0 for a, b in zip(left.position, right.position, strict=True))
    yaw = right.yaw + 0.5 * math.remainder(left.yaw - right.yaw, math.tau)
    return level(x, y, z, yaw)


def interpolate(first: Pose, second: Pose, share: float) -> Pose:
    """Pose between two poses: linear in position, slerp in orientation; ``share``: 0 first, 1 second."""
    a, b = first.orientation, second.orientation
    dot = sum(p * q for p, q in zip(a, b, strict=True))
    if dot < 0.0:
        b, dot = (-b[0], -b[1], -b[2], -b[3]), -dot
    angle = math.acos(min(1.0, dot))
    if angle < 1e-6:
        s, t = 1.0 - share, share
    else:
        s, t = (math.sin((1.0 - share) * angle) / math.sin(angle), math.sin(share * angle) / math.sin(angle))
    w, x, y, z = (s * p + t * q for p, q in zip(a, b, strict=True))
    px, py, pz = (p + share * (q - p) for p, q in zip(first.position, second.position, strict=True))
    return Pose((px, py, pz), unit((w, x, y, z)))
