"""Whether two soles would stand on one another."""

from __future__ import annotations

from collections.abc import Sequence

from valor.common.arrays import FloatArray
from valor.robot.tables import Foot

Vector = Sequence[float] | FloatArray
Points = Sequence[tuple[float, float]]


def outline(position: Vector, rotation: Sequence[Vector] | FloatArray, foot: Foot) -> Points:
    """The corners of a sole from above, in order around it: four of (x, y) [m].

    Python floats, for a plan of fifty steps is checked between two periods of control.

    Args:
        position: (3,) of the sole's frame [m].
        rotation: (3, 3) of it.
        foot: its size.
    """
    x, y = float(position[0]), float(position[1])
    xx, xy = float(rotation[0][0]), float(rotation[0][1])
    yx, yy = float(rotation[1][0]), float(rotation[1][1])
    corners = ((foot.toe, 1.0), (foot.heel, 1.0), (foot.heel, -1.0), (foot.toe, -1.0))
    return [
        (x + xx * ahead + xy * side * foot.half_width, y + yx * ahead + yy * side * foot.half_width)
        for ahead, side in corners
    ]


def overlap(first: Points, second: Points) -> bool:
    """Whether two convex quadrangles have more in common than an edge (theorem of the separating axis)."""
    for corners in (first, second):
        for i in range(2):  # of a parallelogram, two edges have all the directions
            (ax, ay), (bx, by) = corners[i], corners[i + 1]
            nx, ny = ay - by, bx - ax
            ones = [nx * x + ny * y for x, y in first]
            others = [nx * x + ny * y for x, y in second]
            if max(ones) <= min(others) or max(others) <= min(ones):
                return False
    return True
