"""The robot in its nominal posture, as the checks examine it."""

from functools import cached_property
from itertools import pairwise

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.robot import soles
from valor.robot.description import RobotDescription
from valor.robot.legs import pitch_joints
from valor.robot.model import Model, full_model
from valor.robot.tables import SIDES, Foot


class Stance:
    """Robot in its nominal posture above the plane z = 0, at the base height of robot.yaml.

    ``model`` has every joint and the colliding geoms; ``data`` is at rest, after ``mj_forward``.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot
        self.model: Model = full_model(robot, "collision")
        self.data = mujoco.MjData(self.model.mj)
        self.data.qpos[:] = self.model.nominal_qpos()
        mujoco.mj_forward(self.model.mj, self.data)

    def foot(self, side: str) -> Foot:
        """Return the table of a foot."""
        foot: Foot = getattr(self.robot.tables.feet, side)
        return foot

    def site(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return position (3,) [m] and rotation (3, 3) of a site in the world."""
        site = self.data.site(name)
        return site.xpos, site.xmat.reshape(3, 3)

    @cached_property
    def base(self) -> tuple[FloatArray, FloatArray]:
        """Position (3,) [m] and rotation (3, 3) of the base in the world."""
        body = self.data.body(self.robot.tables.base)
        return body.xpos, body.xmat.reshape(3, 3)

    @property
    def com(self) -> FloatArray:
        """Centre of mass (3,) of the robot in the world [m]."""
        com: FloatArray = self.data.subtree_com[self.model.body(self.robot.tables.base)]
        return com

    @cached_property
    def weight(self) -> float:
        """Weight of the robot [N]."""
        mj = self.model.mj
        return float(mj.body_subtreemass[self.model.body(self.robot.tables.base)] * -mj.opt.gravity[2])

    def above(self, body: int) -> list[str]:
        """Return the joints from the base to a body, in that order."""
        return [name for name in reversed(self.model.joints_above(body)) if name in self.robot.index]

    def pitch_joints(self, side: str) -> list[str]:
        """Return hip, knee and ankle of a leg, which rotate about the base's lateral axis or one near it."""
        return pitch_joints(self.data, self.robot.tables.group(f"{side}_leg"), self.base[1][:, 1])

    def leg_length(self, side: str) -> float:
        """Return the length of the straight leg from hip to ankle [m]."""
        anchors = [self.data.joint(name).xanchor for name in self.pitch_joints(side)]
        return float(sum(np.linalg.norm(b - a) for a, b in pairwise(anchors)))

    @property
    def mean_leg_length(self) -> float:
        """Mean length of the straight legs [m]."""
        return sum(self.leg_length(side) for side in SIDES) / len(SIDES)

    def outline(self, side: str) -> soles.Points:
        """Return the corners of a sole seen from above."""
        foot = self.foot(side)
        position, rotation = self.site(foot.sole)
        return soles.outline(position, rotation, foot)


def touching(model: Model, data: mujoco.MjData) -> list[tuple[str, str]]:
    """Return the pairs of bodies in contact, each once, sorted."""
    mj = model.mj
    pairs = (sorted(mj.body(mj.geom_bodyid[geom]).name for geom in contact.geom) for contact in data.contact)
    return sorted({(one, other) for one, other in pairs})
