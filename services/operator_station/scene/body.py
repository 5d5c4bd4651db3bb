"""Kinematics of one posture: joints, and pelvis in odom."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import mujoco

from valor.common.arrays import FloatArray
from valor.robot.model import Model
from valor.robot.soles import Point, convex_hull, outline


class Body:
    """Posture of a model; ``joints`` (n,) [rad] in the robot's order."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.data = mujoco.MjData(model.mj)
        self.data.qpos[:] = model.nominal_qpos()
        self.joints: FloatArray = model.robot.nominal_posture.copy()
        self.update()

    def place(self, position: Iterable[float], orientation: Iterable[float]) -> None:
        """Set the pelvis in odom: position [m] and (w, x, y, z)."""
        self.data.qpos[:3], self.data.qpos[3:7] = tuple(position), tuple(orientation)

    def pose(self, joints: FloatArray) -> None:
        """Set all joints (n,) [rad]."""
        self.joints = joints
        self.data.qpos[self.model.qpos] = joints[self.model.joint_indices]

    def bend(self, joints: Mapping[str, float]) -> None:
        """Set some joints by name [rad]."""
        moved = self.joints.copy()
        for name, angle in joints.items():
            moved[self.model.robot.index[name]] = angle
        self.pose(moved)

    def update(self) -> None:
        """Compute the kinematics."""
        mujoco.mj_kinematics(self.model.mj, self.data)
        mujoco.mj_comPos(self.model.mj, self.data)

    def like(self, other: Body) -> None:
        """Copy and compute a posture of the same robot."""
        self.place(other.data.qpos[:3], other.data.qpos[3:7])
        self.pose(other.joints.copy())
        self.update()

    def site(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return (3,) position [m] and (3, 3) rotation of a site in odom."""
        site = self.data.site(name)
        return site.xpos.copy(), site.xmat.reshape(3, 3).copy()

    def com(self) -> FloatArray:
        """Return the (3,) centre of mass in odom [m]."""
        centre: FloatArray = self.data.subtree_com[1].copy()
        return centre

    def soles(self) -> list[tuple[FloatArray, FloatArray]]:
        """Return the sites of the left and the right sole."""
        feet = self.model.robot.tables.feet
        return [self.site(foot.sole) for foot in (feet.left, feet.right)]

    def support(self, contacts: Iterable[bool]) -> list[Point]:
        """Return the convex hull of the soles in contact, in odom [m]."""
        feet = self.model.robot.tables.feet
        return convex_hull(
            corner
            for (position, turn), foot, bears in zip(self.soles(), (feet.left, feet.right), contacts, strict=True)
            if bears
            for corner in outline(position, turn.tolist(), foot)
        )
