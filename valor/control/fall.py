"""Fall detection.

A fall is detected by pelvis tilt, pelvis height, or a DCM that no force on the soles can bring back.

The DCM moves away from the centre of pressure, ξ̇ = ω·(ξ − CoP), and the CoP stays within the support polygon, the
convex hull of both soles' corners on the ground: a DCM outside it is lost without a step (capturability with zero
steps, Koolen et al. 2012). This is detected long before the robot tilts. A margin and a short duration allow for the
estimate's error and for the effect of swinging arms. While the robot steps, the polygon is that of the next foothold
and the stance foot, and the margin is larger: the step after it can still save the robot (capturability with one step).
"""

from math import degrees, hypot

import numpy as np

from valor.common.arrays import FloatArray
from valor.control.state import RobotState
from valor.control.tuning_tables import Tuning
from valor.robot.description import RobotDescription
from valor.robot.soles import Point, convex_hull, distance_outside
from valor.robot.tables import Feet


def sole_corners(feet: Feet) -> FloatArray:
    """Return (2, 4, 3) corners of the left and right sole, each in its sole's frame [m]."""
    return np.array(
        [
            [(x, y, 0.0) for x in (foot.heel, foot.toe) for y in (foot.half_width, -foot.half_width)]
            for foot in (feet.left, feet.right)
        ]
    )


def inner_radius(feet: Feet) -> float:
    """Return the radius of the largest circles around the soles' origins within the soles [m]."""
    return min(min(-foot.heel, foot.toe, foot.half_width) for foot in (feet.left, feet.right))


def surely_within(positions: FloatArray, rotations: FloatArray, radius: float, point: Point, margin: float) -> bool:
    """Fast sufficient check: whether a point in odom is at most ``margin`` [m] outside the support polygon.

    The polygon contains both soles' inner circles of ``radius`` [m], narrower when tilted, and the area between them.
    """
    (ax, ay, _), (bx, by, _) = positions.tolist()
    x, y = point
    narrow = max(0.0, min(rotations.item(8), rotations.item(17)))
    ex, ey, px, py = bx - ax, by - ay, x - ax, y - ay
    t = min(1.0, max(0.0, (px * ex + py * ey) / max(ex * ex + ey * ey, 1e-12)))
    return hypot(px - t * ex, py - t * ey) <= margin + radius * narrow


def corners_on_ground(corners: FloatArray, positions: FloatArray, rotations: FloatArray) -> list[Point]:
    """Return eight points in odom: (2, 4, 3) corners in the soles' frames, seen from above [m]."""
    placed = np.matmul(corners, rotations.transpose(0, 2, 1)) + positions[:, None]
    return [(x, y) for x, y, _ in placed.reshape(-1, 3).tolist()]


class SupportPolygon:
    """Convex hull of both soles on the ground."""

    def __init__(self, feet: Feet) -> None:
        self._corners, self._radius = sole_corners(feet), inner_radius(feet)

    def dcm_outside(
        self, state: RobotState, margin: float, soles: tuple[FloatArray, FloatArray] | None = None
    ) -> float | None:
        """Distance of the DCM outside the polygon, if above ``margin`` [m]; else None. ``soles``: other poses."""
        positions, rotations = soles or (state.sole_positions_in_odom, state.sole_rotations_in_odom)
        x, y, _ = state.dcm_in_odom.tolist()
        if surely_within(positions, rotations, self._radius, (x, y), margin):
            return None
        outside = distance_outside(convex_hull(corners_on_ground(self._corners, positions, rotations)), x, y)
        return outside if outside > margin else None


class FallDetector:
    """Detects a fall, with the quantity that shows it."""

    def __init__(self, robot: RobotDescription) -> None:
        tables = robot.tables
        self._limits = limits = robot.read(Tuning).fall
        self._lowest = limits.height * tables.nominal_base_height
        self._support = SupportPolygon(tables.feet)
        self._outside_since: int | None = None

    def reset(self) -> None:
        """Clear how long the DCM has been outside."""
        self._outside_since = None

    def update(self, state: RobotState, soles: tuple[FloatArray, FloatArray] | None = None) -> str | None:
        """Return the reason of a fall, or None; ``soles``: poses after the step under way, None while it stands."""
        return self._tilt(state) or self._height(state) or self._dcm(state, soles)

    def _tilt(self, state: RobotState) -> str | None:
        if state.tilt <= self._limits.tilt:
            return None
        return f"pelvis tilted {degrees(state.tilt):.0f}°, limit {degrees(self._limits.tilt):.0f}°"

    def _height(self, state: RobotState) -> str | None:
        soles = state.sole_positions_in_odom
        height = state.pelvis_position_in_odom.item(2) - min(soles.item(2), soles.item(5))
        if height >= self._lowest:
            return None
        return f"pelvis {height:.2f} m above the soles, limit {self._lowest:.2f} m"

    def _dcm(self, state: RobotState, soles: tuple[FloatArray, FloatArray] | None) -> str | None:
        limit = self._limits.dcm_margin if soles is None else self._limits.dcm_margin_stepping
        outside = self._support.dcm_outside(state, limit, soles)
        if outside is None:
            self._outside_since = None
            return None
        if self._outside_since is None:
            self._outside_since = state.time
        lasted = 1e-9 * (state.time - self._outside_since)
        if lasted < self._limits.dcm_duration:
            return None
        return f"DCM {outside:.3f} m outside the support polygon for {lasted:.3f} s, limit {limit:.3f} m"
