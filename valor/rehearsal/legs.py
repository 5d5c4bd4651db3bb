"""A robot's legs, whatever their joints are called."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

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
            anchors = [stance.data.joint(name).xanchor for name in stance.pitch_joints(side)]
            bones = sum(float(np.linalg.norm(b - a)) for a, b in pairwise(anchors))
            lengths.append(bones + float(anchors[-1][2] - stance.site(stance.foot(side).sole)[0][2]))
        self.length = min(lengths)
        self.knees = knees(robot).places
