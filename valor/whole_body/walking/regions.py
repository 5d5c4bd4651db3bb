"""Regions of steps that keep the balance: beside the stance foot, across behind it, and back from there."""

from dataclasses import replace

from valor.control.tuning_tables import Tuning
from valor.robot.description import RobotDescription
from valor.robot.footsteps import Region

# Fractions of the swing: a crossing foot is behind the stance foot's heel before it has come far across …
BACK_FIRST, ACROSS = (0.0, 0.45), (0.2, 1.0)
ASIDE_FIRST = (0.35, 1.0)  # … and the other foot passes its toes before it moves back [1]


class Regions:
    """The regions of a robot."""

    def __init__(self, robot: RobotDescription) -> None:
        table, limits = robot.read(Tuning).disturbance, robot.tables.footsteps
        assert limits is not None
        foot = robot.tables.feet.left
        back = max(limits.max_backward, table.max_backward)
        self.beside = Region((-back, limits.max_forward), (limits.min_width + table.clearance, table.max_width))
        self.uncrossing = replace(self.beside, moves_forward=ASIDE_FIRST)
        self._apart = max(table.cross_apart, foot.toe - foot.heel + table.clearance)
        self._farther, self._over = table.cross_farther, table.cross_over

    def behind(self, backward: float) -> Region | None:
        """Return that across, behind the stance foot, for the DCM's speed backward [m/s]; None: out of reach."""
        nearest = -self._apart - self._farther * max(0.0, backward)
        back = self.beside.forward[0]
        return Region((back, nearest), (-self._over, 0.0), BACK_FIRST, ACROSS) if back < nearest else None

    def crossed(self, outward: float) -> bool:
        """Return whether a foot so far outward of the other one is across it, or before or behind it [m]."""
        return outward < 0.5 * self.beside.outward[0]
