"""The support polygon: the convex hull of both soles' corners on the ground."""

from __future__ import annotations

from math import hypot

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.polygon import Point
from valor.robot.tables import Feet


def sole_corners(feet: Feet) -> FloatArray:
    """(2, 4, 3) corners of the left and right sole, each in its sole's frame [m]."""
    return np.array(
        [
            [(x, y, 0.0) for x in (foot.heel, foot.toe) for y in (foot.half_width, -foot.half_width)]
            for foot in (feet.left, feet.right)
        ]
    )


def inner_radius(feet: Feet) -> float:
    """Of the largest circles around the soles' origins that are within the soles [m]."""
    return min(min(-foot.heel, foot.toe, foot.half_width) for foot in (feet.left, feet.right))


def surely_within(positions: FloatArray, rotations: FloatArray, radius: float, point: Point, margin: float) -> bool:
    """Whether a point is at most ``margin`` outside the support polygon, told without the polygon: often, not always.

    Both soles' inner circles, and what is between them, are within the polygon.

    Args:
        positions: (2, 3) of the soles in odom.
        rotations: (2, 3, 3) of the soles in odom; a tilted circle is narrower from above.
        radius: of the inner circles [m].
        point: in odom [m].
        margin: [m].
    """
    (ax, ay, _), (bx, by, _) = positions.tolist()
    x, y = point
    narrow = max(0.0, min(rotations.item(8), rotations.item(17)))
    ex, ey, px, py = bx - ax, by - ay, x - ax, y - ay
    t = min(1.0, max(0.0, (px * ex + py * ey) / max(ex * ex + ey * ey, 1e-12)))
    return hypot(px - t * ex, py - t * ey) <= margin + radius * narrow


def corners_on_ground(corners: FloatArray, positions: FloatArray, rotations: FloatArray) -> list[Point]:
    """Both soles' corners, seen from above: eight points in odom [m].

    Args:
        corners: (2, 4, 3) in the soles' frames.
        positions: (2, 3) of the soles in odom.
        rotations: (2, 3, 3) of the soles in odom.
    """
    placed = np.matmul(corners, rotations.transpose(0, 2, 1)) + positions[:, None]
    return [(x, y) for x, y, _ in placed.reshape(-1, 3).tolist()]
