"""Soles and support polygons on the ground, seen from above."""

from collections.abc import Iterable, Sequence
from math import hypot

from valor.common.arrays import FloatArray
from valor.robot.tables import Foot

Vector = Sequence[float] | FloatArray
Point = tuple[float, float]
Points = Sequence[Point]


def outline(position: Vector, rotation: Sequence[Vector] | FloatArray, foot: Foot) -> Points:
    """Return the four corners (x, y) of a sole with a pose, seen from above, in order [m]."""
    x, y = float(position[0]), float(position[1])
    xx, xy = float(rotation[0][0]), float(rotation[0][1])
    yx, yy = float(rotation[1][0]), float(rotation[1][1])
    corners = ((foot.toe, 1.0), (foot.heel, 1.0), (foot.heel, -1.0), (foot.toe, -1.0))
    return [
        (x + xx * ahead + xy * side * foot.half_width, y + yx * ahead + yy * side * foot.half_width)
        for ahead, side in corners
    ]


def overlap(first: Points, second: Points) -> bool:
    """Return whether two parallelograms overlap in more than an edge (separating axis theorem)."""
    for corners in (first, second):
        for i in range(2):  # two edges of a parallelogram have all directions
            (ax, ay), (bx, by) = corners[i], corners[i + 1]
            nx, ny = ay - by, bx - ax
            ones = [nx * x + ny * y for x, y in first]
            others = [nx * x + ny * y for x, y in second]
            if max(ones) <= min(others) or max(others) <= min(ones):
                return False
    return True


def convex_hull(points: Iterable[Point]) -> list[Point]:
    """Return the corners of the convex hull, counter-clockwise (Andrew 1979, monotone chain)."""
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
    """Return the distance of a point outside a convex hull [m]; inside, minus the distance to the nearest edge.

    ``hull`` runs counter-clockwise and has at least three corners.
    """
    inside = -float("inf")  # the largest signed distance to an edge's line
    nearest = float("inf")  # the distance to the nearest edge
    ax, ay = hull[-1]
    for bx, by in hull:
        ex, ey = bx - ax, by - ay
        length = hypot(ex, ey)
        ex, ey = ex / length, ey / length  # unit vector: the square of a short length may underflow
        px, py = x - ax, y - ay
        inside = max(inside, px * ey - py * ex)
        along = min(length, max(0.0, px * ex + py * ey))
        nearest = min(nearest, hypot(px - along * ex, py - along * ey))
        ax, ay = bx, by
    return nearest if inside > 0.0 else inside
