"""Convex polygons on the ground: what a robot stands on, and how far a point is from its edge."""

from __future__ import annotations

from collections.abc import Iterable
from math import hypot

Point = tuple[float, float]


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
