"""The robot's posture as the station knows it: joints and pelvis in odom, and all that follows by its kinematics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import mujoco

from valor.common.arrays import FloatArray
from valor.robot.model import Model
from valor.robot.polygon import Point, convex_hull
from valor.robot.soles import outline


class Body:
    """One posture of a model.

    Attributes:
        model: of all joints.
        data: MuJoCo's, of that posture.
        joints: (n,) [rad], in the robot's order.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.data = mujoco.MjData(model.mj)
        self.data.qpos[:] = model.nominal_qpos()
        self.joints: FloatArray = model.robot.nominal_posture.copy()
        self.update()

    def place(self, position: Iterable[float], orientation: Iterable[float]) -> None:
        """The pelvis in odom [m], (w, x, y, z)."""
        self.data.qpos[:3], self.data.qpos[3:7] = tuple(position), tuple(orientation)

    def pose(self, joints: FloatArray) -> None:
        """All joints (n,) [rad]."""
        self.joints = joints
        self.data.qpos[self.model.qpos] = joints[self.model.joint_indices]

    def bend(self, joints: Mapping[str, float]) -> None:
        """Some joints, by name [rad]."""
        moved = self.joints.copy()
        for name, angle in joints.items():
            moved[self.model.robot.index[name]] = angle
        self.pose(moved)

    def update(self) -> None:
        """Compute where everything is."""
        mujoco.mj_kinematics(self.model.mj, self.data)
        mujoco.mj_comPos(self.model.mj, self.data)

    def like(self, other: Body) -> None:
        """Take another's posture, of the same robot."""
        self.place(other.data.qpos[:3], other.data.qpos[3:7])
        self.pose(other.joints.copy())
        self.update()

    def site(self, name: str) -> tuple[FloatArray, FloatArray]:
        """(3,) and (3, 3) of a site in odom."""
        site = self.data.site(name)
        return site.xpos.copy(), site.xmat.reshape(3, 3).copy()

    def com(self) -> FloatArray:
        """(3,) centre of mass in odom [m]."""
        centre: FloatArray = self.data.subtree_com[1].copy()
        return centre

    def soles(self) -> list[tuple[FloatArray, FloatArray]]:
        """Of the left and the right foot."""
        feet = self.model.robot.tables.feet
        return [self.site(foot.sole) for foot in (feet.left, feet.right)]

    def support(self, contacts: Iterable[bool]) -> list[Point]:
        """Corners of the convex hull of the soles that bear, in odom; none without one."""
        feet = self.model.robot.tables.feet
        return convex_hull(
            corner
            for (position, turn), foot, bears in zip(self.soles(), (feet.left, feet.right), contacts, strict=True)
            if bears
            for corner in outline(position, turn.tolist(), foot)
        )
