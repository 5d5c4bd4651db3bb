"""MuJoCo models of a robot for controllers: ``model.xml`` with the values of ``robot.yaml``."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.document import Document
from valor.common.errors import SeveralFaultsError
from valor.robot import arm_calibration
from valor.robot.checks.model_file import compile_fault, coupled, model_faults, require_finite
from valor.robot.description import RobotDescription
from valor.robot.tables import WHOLE_BODY_GROUPS

Indices = slice | npt.NDArray[np.intp]
Shapes = Literal["none", "collision", "all"]


class Model:
    """Compiled model and the addresses of the robot's joints in it.

    ``Indices`` are slices where the addresses are contiguous, so that indexing returns a view. The first joint of
    ``mj`` is the floating base. ``joints`` are the k actuated joints of this model, in the order of ``robot.joints``;
    ``joint_indices`` are theirs in the robot's joint vectors, ``qpos`` and ``dof`` their addresses in the model's.
    """

    def __init__(self, robot: RobotDescription, mj: mujoco.MjModel) -> None:
        self.robot = robot
        self.mj = mj
        present = {mj.joint(i).name for i in range(mj.njnt)}
        self.joints = tuple(name for name in robot.joints if name in present)
        self.joint_indices = _indices(robot.index[name] for name in self.joints)
        self.qpos = _indices(mj.joint(name).qposadr[0] for name in self.joints)
        self.dof = _indices(mj.joint(name).dofadr[0] for name in self.joints)
        passive = robot.tables.passive.items()
        self._resting = [(int(mj.joint(name).qposadr[0]), each.at) for name, each in passive if name in present]

    def body(self, name: str) -> int:
        """Return the id of a body."""
        return int(self.mj.body(name).id)

    def joints_above(self, body: int) -> list[str]:
        """Return the joints from a body to the world, in that order."""
        names = list[str]()
        while body:
            first = int(self.mj.body_jntadr[body])
            names += [self.mj.joint(first + i).name for i in reversed(range(int(self.mj.body_jntnum[body])))]
            body = int(self.mj.body_parentid[body])
        return names

    def shape(self, body: str) -> int:
        """Return the id of the largest geom of a body; the body must have one."""
        geoms = np.flatnonzero(self.mj.geom_bodyid == self.body(body))
        return int(geoms[np.argmax(self.mj.geom_rbound[geoms])])

    def site(self, name: str) -> int:
        """Return the id of a site."""
        return int(self.mj.site(name).id)

    def nominal_qpos(self) -> FloatArray:
        """Return ``qpos`` (nq,) of the upright nominal posture, with the soles on the plane z = 0."""
        qpos: FloatArray = self.mj.qpos0.copy()
        qpos[:7] = (0.0, 0.0, self.robot.tables.nominal_base_height, 1.0, 0.0, 0.0, 0.0)
        qpos[self.qpos] = self.robot.nominal_posture[self.joint_indices]
        for joint, angle in self._resting:
            qpos[joint] = angle
        return qpos


def robot_spec(robot: RobotDescription, shapes: Shapes, *, passive: bool = False) -> mujoco.MjSpec:
    """Return the uncompiled robot with limits, armature and damping of ``robot.yaml``.

    Keeps no geoms, the colliding ones, or all. ``passive``: passive joints move if robot.yaml simulates them. Raises
    ConfigurationError: ``model.xml`` is invalid, or its joints differ from those of ``robot.yaml``.
    """
    file = robot.model_file
    require_finite(robot)
    try:
        spec = mujoco.MjSpec.from_file(str(file))
    except ValueError as error:
        raise compile_fault(robot, str(error)) from None
    SeveralFaultsError.require_none(model_faults(robot, spec))
    actuated = {joint.name: joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE}
    for name, table in robot.tables.joints.items():
        joint = actuated[name]
        joint.armature = table.armature
        joint.damping[0] = table.damping
        if table.lower is not None:
            joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
            joint.range = (table.lower, table.upper)
    _fix_passive(spec, robot, {name for name, each in robot.tables.passive.items() if not (passive and each.simulated)})
    for geom in list(spec.geoms):
        if shapes == "none" or (shapes == "collision" and not (geom.contype or geom.conaffinity)):
            spec.delete(geom)
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):  # reading unused meshes would take seconds
        if (mesh.name or Path(mesh.file).stem) not in used:
            spec.delete(mesh)
    spec.option.timestep = robot.tables.physics_step
    return spec


def controller_model(robot: RobotDescription) -> Model:
    """Return the Whole-Body Controller's model: other joints welded, arms with calibrated masses.

    Only bodies of ``self_collision`` have geoms. Raises ConfigurationError also if the calibration does not fit.
    """
    spec = robot_spec(robot, "collision")
    _weigh(spec, robot)
    apart = {body for pair in robot.tables.self_collision.pairs for body in pair}
    for geom in list(spec.geoms):
        if geom.parent.name not in apart:
            spec.delete(geom)
    weld_others(spec, robot)
    return Model(robot, compiled(robot, spec))


def weld_others(spec: mujoco.MjSpec, robot: RobotDescription, groups: Sequence[str] = WHOLE_BODY_GROUPS) -> None:
    """Weld the joints of other groups, by default those that do not balance, as in the nominal posture."""
    moved = {name for group in groups for name in robot.tables.group(group)}
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE and joint.name not in moved:
            _weld(spec, joint, robot.tables.nominal_posture.get(joint.name, 0.0))


def full_model(robot: RobotDescription, shapes: Shapes = "none") -> Model:
    """Return the nominal model with every joint, for kinematics, tf and pictures."""
    return Model(robot, compiled(robot, robot_spec(robot, shapes)))


def compiled(robot: RobotDescription, spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a spec; raise its errors as ``ConfigurationError``."""
    try:
        return spec.compile()
    except ValueError as error:
        raise compile_fault(robot, str(error)) from None


def matrix(quaternion: Sequence[float] | FloatArray) -> FloatArray:
    """Return the rotation matrix (3, 3) of a quaternion (w, x, y, z)."""
    out = np.empty(9)
    mujoco.mju_quat2Mat(out, np.asarray(quaternion, dtype=float))
    return out.reshape(3, 3)


def _weigh(spec: mujoco.MjSpec, robot: RobotDescription) -> None:
    """Give the arms' bodies the mass and CoM that were found, their inertia going with the mass."""
    calibrations = arm_calibration.load(robot)
    for group, arm in calibrations.present() if calibrations else ():
        for name, link in arm.links.items():
            body = spec.body(name)
            if body is None or not body.explicitinertial or body.mass <= 0:
                what = f"expected a body of {robot.tables.model} with an inertial"
                raise Document.load(robot.folder / arm_calibration.FILE).error((group, "links", name), what)
            body.inertia *= link.mass / body.mass
            body.fullinertia *= link.mass / body.mass
            body.mass, body.ipos = link.mass, link.com


def _fix_passive(spec: mujoco.MjSpec, robot: RobotDescription, fixed: set[str]) -> None:
    """Weld passive joints at their rest position and remove their couplings."""
    if not fixed:
        return
    for equality in list(spec.equalities):
        if fixed.intersection(coupled(spec, equality)):
            spec.delete(equality)
    for joint in list(spec.joints):
        if joint.name in fixed:
            _weld(spec, joint, robot.tables.passive[joint.name].at)


def _weld(spec: mujoco.MjSpec, joint: mujoco.MjsJoint, angle: float) -> None:
    """Remove a hinge, leaving its body rotated by ``angle`` [rad]."""
    body = joint.parent
    turn, orientation = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, joint.axis / np.linalg.norm(joint.axis), angle)
    mujoco.mju_mulQuat(orientation, body.quat, turn)
    # The hinge's anchor keeps its position: p + R·a = p' + R·Rot(angle)·a.
    before, after = np.zeros(3), np.zeros(3)
    mujoco.mju_rotVecQuat(before, joint.pos, body.quat)
    mujoco.mju_rotVecQuat(after, joint.pos, orientation)
    body.pos = body.pos + before - after
    body.quat = orientation
    spec.delete(joint)


def _indices(values: Iterable[int]) -> Indices:
    indices = np.fromiter(values, dtype=np.intp)
    if indices.size and np.array_equal(indices, np.arange(indices[0], indices[0] + indices.size)):
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices
