"""What is drawn about a robot that is no part of it: forces, balance, support, out of what it says of itself.

Geometry alone, of public messages; who draws it is another's affair. All is in one frame, that of the soles' poses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.colors import COM, COP, DCM, DCM_REFERENCE, FORCE, SUPPORT
from valor.common.poses import Pose
from valor.robot.polygon import convex_hull
from valor.robot.soles import outline
from valor.robot.tables import Feet

METRES_A_NEWTON = 1e-3  # of a force's arrow, for a robot as heavy as ESCHER
TOUCHING = 20.0  # a foot that carries less shows no force [N]
LIFT = 0.006  # of what lies on the ground, so that it is seen [m]


@dataclass(frozen=True)
class Arrow:
    """From where to where [m]."""

    start: FloatArray  # (3,)
    end: FloatArray  # (3,)
    color: str  # #rrggbb
    width: float = 0.018  # of its shaft [m]
    alpha: float = 1.0


@dataclass(frozen=True)
class Ball:
    """A point."""

    position: FloatArray  # (3,) [m]
    color: str
    radius: float = 0.03  # [m]
    alpha: float = 1.0


@dataclass(frozen=True)
class Line:
    """Through points, perhaps back to the first."""

    points: FloatArray  # (n, 3) [m]
    color: str
    width: float = 0.006  # [m]
    closed: bool = False
    alpha: float = 1.0


Mark = Arrow | Ball | Line


def forces(soles: Sequence[Pose], wrenches: FloatArray, scale: float = METRES_A_NEWTON) -> list[Mark]:
    """An arrow under each foot that carries weight: its force, from where that acts in the sole.

    Args:
        soles: of the left and the right foot.
        wrenches: (2, 6) on them by the ground, force [N] and torque [N·m], each in its sole.
        scale: [m/N].
    """
    marks: list[Mark] = []
    for sole, wrench in zip(soles, wrenches, strict=True):
        x, y, z, about_x, about_y, _ = map(float, wrench)
        if not math.isfinite(z) or z < TOUCHING:
            continue
        at = np.array((sole @ Pose((-about_y / z, about_x / z, 0.0))).position)
        end = np.array((sole @ Pose((-about_y / z + scale * x, about_x / z + scale * y, scale * z))).position)
        marks.append(Arrow(at, end, FORCE))
    return marks


def support(soles: Sequence[Pose], contacts: Sequence[bool], feet: Feet) -> list[Mark]:
    """The outline of what carries: the convex hull of the soles that stand, at the higher one's height.

    Args:
        soles: of the left and the right foot.
        contacts: which of them stand.
        feet: their sizes.
    """
    standing = [
        (sole, foot) for sole, stands, foot in zip(soles, contacts, (feet.left, feet.right), strict=True) if stands
    ]
    hull = convex_hull(corner for sole, foot in standing for corner in outline(sole.position, sole.rotation, foot))
    if len(hull) < 3:
        return []
    height = max(sole.position[2] for sole, _ in standing) + LIFT
    return [Line(np.array([(x, y, height) for x, y in hull]), SUPPORT, closed=True)]


def balance(com: FloatArray, dcm: FloatArray, reference: FloatArray, cop: FloatArray, ground: float) -> list[Mark]:
    """CoM with its plumb line; DCM, what it shall be, and CoP, all three where they are over the ground.

    Args:
        com: (3,) [m].
        dcm: (3,) [m].
        reference: (3,) what the DCM shall be [m].
        cop: (2,) [m]; NaN without contact.
        ground: height of the ground there [m].
    """
    height = ground + LIFT
    below = np.array([com[0], com[1], height])
    marks: list[Mark] = [Ball(com, COM, 0.04), Line(np.stack([com, below]), COM, 0.004)]
    for point, color, radius in ((reference, DCM_REFERENCE, 0.02), (dcm, DCM, 0.03), (cop, COP, 0.025)):
        if np.isfinite(point).all():
            marks.append(Ball(np.array([point[0], point[1], height]), color, radius))
    return marks


def trace(points: FloatArray, color: str, width: float = 0.006) -> list[Mark]:
    """The way that a point went: (n, 3) [m]."""
    return [Line(np.stack(pair), color, width) for pair in pairwise(points)] if len(points) > 1 else []
