"""Whether two soles would stand on one another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from valor_common.robot import Foot

Points = Sequence[Sequence[float]]


def outline(position: npt.ArrayLike, rotation: npt.ArrayLike, foot: Foot) -> list[list[float]]:
    """The corners of a sole from above, in order around it: four of (x, y) [m].

    Args:
        position: (3,) of the sole's frame [m].
        rotation: (3, 3) of it.
        foot: its size.
    """
    corners = np.array(
        (
            (foot.toe, foot.half_width),
            (foot.heel, foot.half_width),
            (foot.heel, -foot.half_width),
            (foot.toe, -foot.half_width),
        )
    )
    points: list[list[float]] = (corners @ np.asarray(rotation)[:2, :2].T + np.asarray(position)[:2]).tolist()
    return points


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
