"""Foxglove primitives from numbers."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

from foxglove.messages import Color, Point3, Pose, Quaternion, Timestamp, Vector3

from valor.drawing.marks import rgb

_NO_TURN = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)


def color(text: str, alpha: float = 1.0) -> Color:
    """Return the color of ``#rrggbb``."""
    red, green, blue = (part / 255.0 for part in rgb(text))
    return Color(r=red, g=green, b=blue, a=alpha)


def pose(position: Sequence[float], turn: Sequence[float] | None = None) -> Pose:
    """Return a pose from (3,) position [m] and (w, x, y, z)."""
    x, y, z = (float(each) for each in position)
    orientation = _NO_TURN
    if turn is not None:
        w, qx, qy, qz = (float(each) for each in turn)
        orientation = Quaternion(x=qx, y=qy, z=qz, w=w)
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=orientation)


def of_ros(message: Any, lift: float = 0.0) -> Pose:
    """Return the pose of a ``geometry_msgs/Pose``, ``lift`` [m] higher."""
    at, turn = message.position, message.orientation
    return pose((at.x, at.y, at.z + lift), (turn.w, turn.x, turn.y, turn.z))


def points(those: Iterable[Sequence[float]]) -> list[Point3]:
    """Return points from (n, 3) positions [m]."""
    return [Point3(x=float(x), y=float(y), z=float(z)) for x, y, z in those]


def size(x: float, y: float, z: float) -> Vector3:
    """Return the size of a box or an ellipsoid [m]."""
    return Vector3(x=float(x), y=float(y), z=float(z))


def along(vector: Sequence[float]) -> tuple[float, float, float, float]:
    """Return the rotation (w, x, y, z) of the x axis to a vector's direction."""
    x, y, z = vector
    length = math.sqrt(x * x + y * y + z * z)
    if length == 0.0 or x <= -length * (1.0 - 1e-12):
        return (0.0, 0.0, 0.0, 1.0)  # half a turn about z
    w, qy, qz = length + x, -z, y  # (1 + cos, x̂ × v̂), times the length
    norm = math.sqrt(w * w + qy * qy + qz * qz)
    return (w / norm, 0.0, qy / norm, qz / norm)


def stamp(message: Any) -> Timestamp:
    """Return the time of a ``builtin_interfaces/Time``."""
    return Timestamp(sec=max(0, message.sec), nsec=message.nanosec)
