"""Is the robot lost? By its tilt, its height, or a DCM that no force on the soles can bring back.

The DCM moves away from the centre of pressure, ξ̇ = ω·(ξ − CoP), and the CoP stays within the support polygon: a DCM
outside of it is lost without a step (capturability with zero steps, Koolen et al. 2012). That is known long before the
robot tilts. A margin and a short time leave room for the estimate's error and for what the arms' swing can still do.
While the robot steps the polygon is that of the foothold to come and of the foot that stays, and a DCM outside of it
is lost when the step after that cannot reach it either (capturability with one step more): the margin is larger.
"""

from __future__ import annotations

from math import acos, degrees

from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription
from valor.robot.polygon import convex_hull, distance_outside
from valor.whole_body.balance.support import corners_on_ground, inner_radius, sole_corners, surely_within
from valor.whole_body.state import RobotState
from valor.whole_body.tuning_tables import Tuning


class FallDetector:
    """Says that the robot falls, and by which quantity."""

    def __init__(self, robot: RobotDescription) -> None:
        tables = robot.tables
        self._limits = limits = robot.read(Tuning).fall
        self._lowest = limits.height * tables.nominal_base_height
        self._corners = sole_corners(tables.feet)
        self._radius = inner_radius(tables.feet)
        self._outside_since: int | None = None

    def reset(self) -> None:
        """Forget how long the DCM has been outside."""
        self._outside_since = None

    def update(self, state: RobotState, soles: tuple[FloatArray, FloatArray] | None = None) -> str | None:
        """A reason that names quantity, value and limit; None while the robot is not falling.

        Args:
            state: the estimate.
            soles: positions (2, 3) and rotations (2, 3, 3) where the soles can push after the step that is being
                taken; None: the robot stands, they are where they are.
        """
        return self._tilt(state) or self._height(state) or self._dcm(state, soles)

    def _tilt(self, state: RobotState) -> str | None:
        tilt = acos(min(1.0, max(-1.0, state.pelvis_rotation_in_odom.item(8))))
        if tilt <= self._limits.tilt:
            return None
        return f"pelvis tilted {degrees(tilt):.0f}°, limit {degrees(self._limits.tilt):.0f}°"

    def _height(self, state: RobotState) -> str | None:
        soles = state.sole_positions_in_odom
        height = state.pelvis_position_in_odom.item(2) - min(soles.item(2), soles.item(5))
        if height >= self._lowest:
            return None
        return f"pelvis {height:.2f} m above the soles, limit {self._lowest:.2f} m"

    def _dcm(self, state: RobotState, soles: tuple[FloatArray, FloatArray] | None) -> str | None:
        positions, rotations = soles or (state.sole_positions_in_odom, state.sole_rotations_in_odom)
        x, y, _ = state.dcm_in_odom.tolist()
        limit = self._limits.dcm_margin if soles is None else self._limits.dcm_margin_stepping
        if surely_within(positions, rotations, self._radius, (x, y), limit):
            self._outside_since = None
            return None
        points = corners_on_ground(self._corners, positions, rotations)
        outside = distance_outside(convex_hull(points), x, y)
        if outside <= limit:
            self._outside_since = None
            return None
        if self._outside_since is None:
            self._outside_since = state.time
        lasted = 1e-9 * (state.time - self._outside_since)
        if lasted < self._limits.dcm_duration:
            return None
        return f"DCM {outside:.3f} m outside the support polygon for {lasted:.3f} s, limit {limit:.3f} m"
