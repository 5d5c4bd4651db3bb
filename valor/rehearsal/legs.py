"""A robot's legs, whatever their joints are called."""

from __future__ import annotations

from valor.robot.checks import SIDES, Stance
from valor.robot.description import RobotDescription
from valor.robot.legs import knees


class Legs:
    """How long a robot's legs are, and which of their joints are the knees.

    Attributes:
        length: of the straight leg, hip to sole [m].
        knees: (2,) places in every joint vector.
    """

    def __init__(self, robot: RobotDescription) -> None:
        stance = Stance(robot)
        lengths = []
        for side in SIDES:
            ankle = stance.data.joint(stance.pitch_joints(side)[-1]).xanchor
            sole, _ = stance.site(stance.foot(side).sole)
            lengths.append(stance.leg_length(side) + float(ankle[2] - sole[2]))
        self.length = min(lengths)
        self.knees = knees(robot).places
