"""A robot in the sagittal plane, as CasADi expressions: left and right do the same.

Its posture has few coordinates then: where the pelvis is (x, z), its pitch, and one angle for each joint of the left
side and the middle; a joint of the right side mirrors its twin. Of all generalised forces only those are left that move
these coordinates, and for a motion and a load that are symmetric they are the whole truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.common.turns import about
from valor.planning.sides import Sides
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.model import Model
from valor.robot.quaternion import matrix

Expression = Any  # casadi.SX; the library is not typed
BASE = 3  # coordinates of the pelvis: x [m], z [m], pitch [rad]


@dataclass(frozen=True, slots=True)
class Ends:
    """Balls that stand for a shape: the corners of a box, the two ends of a capsule."""

    body: int
    points: FloatArray  # (k, 3) in the body's frame [m]
    radius: float  # [m]


class SagittalPosture:
    """Coordinates of a symmetric posture, and what follows from them.

    Attributes:
        model: the MuJoCo model, every joint in it.
        joints: one name a coordinate after the pelvis', of the left side or the middle; m of them.
        lower, upper: (m,) limits [rad]; effort: (m,) of one joint [N·m].
        sides: what is the same on either side.
        mass: of the robot [kg].
        weight: [N].
    """

    def __init__(self, model: Model, joints: tuple[str, ...]) -> None:
        """Take the joints of the left side and the middle that may move; the others stay at zero.

        Raises:
            ConfigurationError: a joint is unknown, or the sides have not as many joints.
        """
        robot, mj = model.robot, model.mj
        self.model = model
        self.joints = joints
        if unknown := [name for name in joints if name not in robot.index]:
            raise ConfigurationError(f"{robot.folder}: no joint {unknown[0]!r}; expected one of robot.yaml")
        self.sides = Sides(model)
        rows = np.array([robot.index[name] for name in joints])
        self._twins = [self.sides.joint(name) for name in joints]
        self.limits = CommandedLimits.of_joints(robot).select(rows)
        self.mass = float(mj.body_subtreemass[0])
        self.weight = self.mass * float(-mj.opt.gravity[2])
        self._signs = [mirror_sign(mj, left, right) for left, right in zip(joints, self._twins, strict=True)]
        self.multiplicity = np.array([1.0 if a == b else 2.0 for a, b in zip(joints, self._twins, strict=True)])

    def full(self, angles: Mapping[str, float]) -> dict[str, float]:
        """Angles of both sides for those of the left side and the middle [rad]."""
        out: dict[str, float] = {}
        for name, angle in angles.items():
            out[name] = angle
            if (right := self.sides.joint(name)) != name:
                out[right] = angle * mirror_sign(self.model.mj, name, right)
        return out

    def qpos(self, coordinates: FloatArray) -> FloatArray:
        """(nq,) of the MuJoCo model for (3 + m,) coordinates."""
        qpos = np.zeros(self.model.mj.nq)
        x, z, pitch = coordinates[:BASE]
        qpos[:7] = (x, 0.0, z, np.cos(0.5 * pitch), 0.0, np.sin(0.5 * pitch), 0.0)
        for name, angle in self.full(dict(zip(self.joints, coordinates[BASE:], strict=True))).items():
            qpos[self.model.mj.joint(name).qposadr[0]] = angle
        return qpos

    def frames(self, coordinates: Expression) -> list[tuple[Expression, Expression]]:
        """Position (3,) [m] and rotation (3, 3) of every body in the world, by its id."""
        mj = self.model.mj
        angles: dict[str, Expression] = {}
        for i, (name, right, sign) in enumerate(zip(self.joints, self._twins, self._signs, strict=True)):
            angles[name] = coordinates[BASE + i]
            angles[right] = angles[name] if name == right else sign * angles[name]
        frames = [(ca.SX.zeros(3), ca.SX.eye(3))]
        for body in range(1, mj.nbody):
            position, rotation = frames[mj.body_parentid[body]]
            first = mj.body_jntadr[body]
            if first >= 0 and mj.jnt_type[first] == mujoco.mjtJoint.mjJNT_FREE:
                position = ca.vertcat(coordinates[0], 0.0, coordinates[1])
                rotation = about(np.array([0.0, 1.0, 0.0]), coordinates[2])
            else:
                position = position + rotation @ mj.body_pos[body]
                rotation = rotation @ matrix(mj.body_quat[body])
                for joint in range(first, first + mj.body_jntnum[body]):
                    anchor = mj.jnt_pos[joint]
                    turned = rotation @ about(mj.jnt_axis[joint], angles.get(mj.joint(joint).name, 0.0))
                    position = position + (rotation - turned) @ anchor
                    rotation = turned
            frames.append((position, rotation))
        return frames

    def com(self, frames: list[tuple[Expression, Expression]]) -> Expression:
        """(3,) [m]."""
        mj = self.model.mj
        parts = [
            mass * (position + rotation @ offset)
            for (position, rotation), mass, offset in zip(frames, mj.body_mass, mj.body_ipos, strict=True)
        ]
        return sum(parts[1:], parts[0]) / self.mass

    def shapes(self) -> list[Ends]:
        """What must not go through the floor, of the left side and the middle: every shape that collides."""
        mj, out = self.model.mj, []
        for geom in range(mj.ngeom):
            right = self.sides.is_right(int(mj.geom_bodyid[geom]))
            if right or not (mj.geom_contype[geom] or mj.geom_conaffinity[geom]):
                continue
            points, radius = ends(mj, geom)
            points = points @ matrix(mj.geom_quat[geom]).T + mj.geom_pos[geom]
            out.append(Ends(int(mj.geom_bodyid[geom]), points, radius))
        return out


def mirror_sign(mj: mujoco.MjModel, left: str, right: str) -> float:
    """1 if twins turn by the same angle when they do the same, −1 if by the opposite one.

    Seen in the mirror of the sagittal plane, an axis (x, y, z), which is a pseudo-vector, is (−x, y, −z).
    """
    seen = mj.joint(left).axis * (-1.0, 1.0, -1.0)
    return 1.0 if left == right or float(seen @ mj.joint(right).axis) > 0.0 else -1.0


def ends(mj: mujoco.MjModel, geom: int) -> tuple[FloatArray, float]:
    """Points (k, 3) in a geom's frame and a radius [m]: the hull of balls around them is the shape.

    Raises:
        ConfigurationError: the shape is neither a sphere nor a capsule nor a box.
    """
    kind, size = mj.geom_type[geom], mj.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.zeros((1, 3)), float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return np.array([[0.0, 0.0, size[1]], [0.0, 0.0, -size[1]]]), float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        signs = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
        return signs * size, 0.0
    body = mj.body(mj.geom_bodyid[geom]).name
    raise ConfigurationError(f"{body}: a shape of kind {mujoco.mjtGeom(kind).name}; expected sphere, capsule or box")
