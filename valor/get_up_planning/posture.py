"""Symmetric postures of a robot as CasADi expressions.

The coordinates are the pelvis position (x, z), its pitch, and one angle for each joint of the left side and the middle;
joints of the right side mirror those of the left. For a symmetric load the generalised forces of these coordinates
describe the equilibrium completely.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.common.kernel import about
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.model import Model, matrix

Expression = Any  # casadi.SX; the library is not typed
BASE = 3  # coordinates of the pelvis: x [m], z [m], pitch [rad]
_LEFT, _RIGHT = "left_", "right_"  # prefixes of group names


class Sides:
    """Correspondence of left and right joints, by their index in the groups, and of bodies, by joint or position."""

    def __init__(self, model: Model) -> None:
        robot, self._mj, self._above = model.robot, model.mj, model.joints_above
        groups = robot.tables.groups
        self._mirrored: dict[str, str] = {}
        for name in groups:
            if name.startswith(_LEFT):
                left, right = groups[name], robot.tables.group(_RIGHT + name.removeprefix(_LEFT))
                if len(left) != len(right):
                    what = f"{len(left)} joints, its counterpart {len(right)}; expected equal numbers"
                    raise robot.error(["groups", name], what)
                self._mirrored |= dict(zip(left, right, strict=True))
        self._right = frozenset(self._mirrored.values())
        data = mujoco.MjData(self._mj)
        data.qpos[:] = model.nominal_qpos()
        mujoco.mj_kinematics(self._mj, data)
        self._positions = data.xpos

    def joint(self, name: str) -> str:
        """Return the right counterpart of a left joint; any other joint itself."""
        return self._mirrored.get(name, name)

    def body(self, name: str) -> str:
        """Return the right counterpart of a left body; any other body itself."""
        mj = self._mj
        body = int(mj.body(name).id)
        above = self._above(body)
        if not above or above[0] not in self._mirrored:
            return name
        other = int(mj.joint(self._mirrored[above[0]]).bodyid[0])
        if not mj.body_jntnum[body]:  # of the bodies fixed to the counterpart, the one nearest to the mirror image
            seen = self._positions[body] * (1.0, -1.0, 1.0)
            fixed = [each for each in range(mj.nbody) if self._above(each)[:1] == [self._mirrored[above[0]]]]
            other = min(fixed, key=lambda each: float(np.linalg.norm(self._positions[each] - seen)))
        return str(mj.body(other).name)

    def is_right(self, body: int) -> bool:
        return bool(self._right.intersection(self._above(body)))


@dataclass(frozen=True, slots=True)
class Ends:
    """Spheres whose convex hull is a shape: the corners of a box, the two ends of a capsule."""

    body: int
    points: FloatArray  # (k, 3) in the body's frame [m]
    radius: float  # [m]


class SagittalPosture:
    """Coordinates of a symmetric posture and functions of them."""

    def __init__(self, model: Model, joints: tuple[str, ...]) -> None:
        """Select the joints of the left side and the middle that may move; raises ``ConfigurationError``."""
        robot, mj = model.robot, model.mj
        self.model = model  # the MuJoCo model with every joint
        self.joints = joints  # names of the m coordinates after the pelvis', of the left side or the middle
        if unknown := [name for name in joints if name not in robot.index]:
            raise ConfigurationError(f"{robot.folder}: no joint {unknown[0]!r}; expected one of robot.yaml")
        self.sides = Sides(model)  # correspondence of left and right
        rows = np.array([robot.index[name] for name in joints])
        self._mirrored = [self.sides.joint(name) for name in joints]
        self.limits = CommandedLimits.of_joints(robot).select(rows)
        self.mass = float(mj.body_subtreemass[0])  # of the robot [kg]
        self.weight = self.mass * float(-mj.opt.gravity[2])  # [N]
        self._signs = [mirror_sign(mj, left, right) for left, right in zip(joints, self._mirrored, strict=True)]
        self.multiplicity = np.array([1.0 if a == b else 2.0 for a, b in zip(joints, self._mirrored, strict=True)])

    def full(self, angles: Mapping[str, float]) -> dict[str, float]:
        """Return the angles of both sides for those of the left side and the middle [rad]."""
        out: dict[str, float] = {}
        for name, angle in angles.items():
            out[name] = angle
            if (right := self.sides.joint(name)) != name:
                out[right] = angle * mirror_sign(self.model.mj, name, right)
        return out

    def qpos(self, coordinates: FloatArray) -> FloatArray:
        """Return ``qpos`` (nq,) of the MuJoCo model for coordinates (3 + m,)."""
        qpos = np.zeros(self.model.mj.nq)
        x, z, pitch = coordinates[:BASE]
        qpos[:7] = (x, 0.0, z, np.cos(0.5 * pitch), 0.0, np.sin(0.5 * pitch), 0.0)
        for name, angle in self.full(dict(zip(self.joints, coordinates[BASE:], strict=True))).items():
            qpos[self.model.mj.joint(name).qposadr[0]] = angle
        return qpos

    def frames(self, coordinates: Expression) -> list[tuple[Expression, Expression]]:
        """Return position (3,) [m] and rotation (3, 3) of every body in the world, by its id."""
        mj = self.model.mj
        angles: dict[str, Expression] = {}
        for i, (name, right, sign) in enumerate(zip(self.joints, self._mirrored, self._signs, strict=True)):
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
        """Return the centre of mass (3,) in the world [m]."""
        mj = self.model.mj
        parts = [
            mass * (position + rotation @ offset)
            for (position, rotation), mass, offset in zip(frames, mj.body_mass, mj.body_ipos, strict=True)
        ]
        return sum(parts[1:], parts[0]) / self.mass

    def shapes(self) -> list[Ends]:
        """Return the colliding shapes of the left side and the middle."""
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
    """Return 1 if corresponding joints have equal angles in symmetric postures, −1 if opposite ones.

    An axis (x, y, z) is a pseudo-vector; its image in the sagittal plane is (−x, y, −z).
    """
    seen = mj.joint(left).axis * (-1.0, 1.0, -1.0)
    return 1.0 if left == right or float(seen @ mj.joint(right).axis) > 0.0 else -1.0


def ends(mj: mujoco.MjModel, geom: int) -> tuple[FloatArray, float]:
    """Return points (k, 3) in a geom's frame and a radius [m]: the convex hull of these spheres is the shape."""
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
