"""The support polygon: the convex hull of both soles' corners on the ground."""

from __future__ import annotations

from collections.abc import Iterable
from math import hypot

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.tables import Feet

Point = tuple[float, float]


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


def convex_hull(points: Iterable[Point]) -> list[Point]:
    """Corners of the convex hull, counter-clockwise (Andrew 1979, monotone chain)."""
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return ordered
    chains: list[list[Point]] = []
    for run in (ordered, ordered[::-1]):
        chain: list[Point] = []
        for px, py in run:
            while len(chain) > 1:
                (ax, ay), (bx, by) = chain[-2], chain[-1]
                if (bx - ax) * (py - ay) - (by - ay) * (px - ax) > 0.0:
                    break
                chain.pop()
            chain.append((px, py))
        chains.append(chain)
    return chains[0][:-1] + chains[1][:-1]


def distance_outside(hull: list[Point], x: float, y: float) -> float:
    """How far a point is outside a convex hull [m]; negative inside, by the distance to the nearest edge.

    ``hull`` runs counter-clockwise and has at least three corners.
    """
    inside = -float("inf")  # the largest signed distance to an edge's line
    nearest = float("inf")  # the distance to the nearest edge
    ax, ay = hull[-1]
    for bx, by in hull:
        ex, ey = bx - ax, by - ay
        length = hypot(ex, ey)
        ex, ey = ex / length, ey / length  # a direction: the square of a short length may be zero
        px, py = x - ax, y - ay
        inside = max(inside, px * ey - py * ex)
        along = min(length, max(0.0, px * ex + py * ey))
        nearest = min(nearest, hypot(px - along * ex, py - along * ey))
        ax, ay = bx, by
    return nearest if inside > 0.0 else inside
