"""Marks drawn around a robot: forces, balance, support, from public messages; all in the frame of the soles' poses."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.poses import Pose
from valor.robot.soles import convex_hull, outline
from valor.robot.tables import Feet

# Palette of Okabe and Ito, suitable for color-blind viewers: of the robot in films, the operator's page and Foxglove.
LEFT, RIGHT = "#0072b2", "#d55e00"  # feet, soles, knees
FORCE, SUPPORT, COM, DCM, DCM_REFERENCE, COP = "#d55e00", "#56b4e9", "#e69f00", "#cc79a7", "#22272e", "#009e73"
BALANCE = {"com": COM, "dcm": DCM, "dcm_reference": DCM_REFERENCE, "cop": COP}
"""By name of the point's topic."""

METRES_A_NEWTON = 1e-3  # Scale of force arrows for a robot of ESCHER's weight [m/N]
TOUCHING = 20.0  # Least vertical force drawn [N]
LIFT = 0.006  # Height of marks above the ground, for visibility [m]


def rgb(color: str) -> tuple[int, int, int]:
    """Red, green and blue of ``#rrggbb``, 0 to 255."""
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue


@dataclass(frozen=True)
class Arrow:
    """Arrow between two points [m]."""

    start: FloatArray  # (3,)
    end: FloatArray  # (3,)
    color: str  # #rrggbb
    width: float = 0.018  # of its shaft [m]


@dataclass(frozen=True)
class Ball:
    """Ball at a point."""

    position: FloatArray  # (3,) [m]
    color: str
    radius: float = 0.03  # [m]


@dataclass(frozen=True)
class Polyline:
    """Line through points, optionally closed."""

    points: FloatArray  # (n, 3) [m]
    color: str
    width: float = 0.006  # [m]
    closed: bool = False


Mark = Arrow | Ball | Polyline


def forces(soles: Sequence[Pose], wrenches: FloatArray, scale: float = METRES_A_NEWTON) -> list[Mark]:
    """Return an arrow of the ground force for each loaded foot, from the point of action in the sole.

    ``wrenches`` (2, 6) act on the left and right sole, force [N] and torque [N·m] in the sole; ``scale`` is in m/N.
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
    """Return the outline of the support polygon of the standing feet, at the height of the higher sole."""
    standing = [
        (sole, foot) for sole, stands, foot in zip(soles, contacts, (feet.left, feet.right), strict=True) if stands
    ]
    hull = convex_hull(corner for sole, foot in standing for corner in outline(sole.position, sole.rotation, foot))
    if len(hull) < 3:
        return []
    height = max(sole.position[2] for sole, _ in standing) + LIFT
    return [Polyline(np.array([(x, y, height) for x, y in hull]), SUPPORT, closed=True)]


def balance(com: FloatArray, dcm: FloatArray, reference: FloatArray, cop: FloatArray, ground: float) -> list[Mark]:
    """Return the CoM with a plumb line; DCM, its reference and the CoP on the ground.

    ``com``, ``dcm``, ``reference`` (3,), and ``cop`` (2,), NaN without contact, are in m; ``ground`` is its height [m].
    """
    height = ground + LIFT
    below = np.array([com[0], com[1], height])
    marks: list[Mark] = [Ball(com, COM, 0.04), Polyline(np.stack([com, below]), COM, 0.004)]
    for point, color, radius in ((reference, DCM_REFERENCE, 0.02), (dcm, DCM, 0.03), (cop, COP, 0.025)):
        if np.isfinite(point).all():
            marks.append(Ball(np.array([point[0], point[1], height]), color, radius))
    return marks


def trace(points: FloatArray, color: str, width: float = 0.006) -> list[Mark]:
    """Return the path of a point: (n, 3) positions [m]."""
    return [Polyline(np.stack(pair), color, width) for pair in pairwise(points)] if len(points) > 1 else []
