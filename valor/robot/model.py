"""MuJoCo models of a robot: ``model.xml`` with the numbers of ``robot.yaml`` written into it.

``robot_spec`` is what every model begins with. ``controller_model`` and ``full_model`` are compiled from it here; the
simulated plant, with a world and errors of its own, is built in ``valor.simulation``, so that the two can
differ. A ``Model`` knows where each joint's numbers stand in MuJoCo's vectors.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.document import Document
from valor.common.errors import SeveralFaultsError
from valor.robot import arm_calibration
from valor.robot.description import RobotDescription
from valor.robot.model_faults import compile_fault, coupled, model_faults
from valor.robot.tables import WHOLE_BODY_GROUPS

Indices = slice | npt.NDArray[np.intp]
Shapes = Literal["none", "collision", "all"]


class Model:
    """A compiled model and the addresses of the robot's joints in it.

    Every ``Indices`` is a slice where the numbers are contiguous, so that indexing gives a view and costs nothing.

    Attributes:
        robot: the robot's description.
        mj: the MuJoCo model. The first joint is the floating base.
        joints: names of the actuated joints in this model, k of them, in the order of ``robot.joints``.
        joint_indices: their places in every joint vector of the robot.
        qpos: their places in ``qpos``.
        dof: their places in ``qvel``, ``qacc`` and every other vector over degrees of freedom.
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
        """A body's id."""
        return int(self.mj.body(name).id)

    def joints_above(self, body: int) -> list[str]:
        """The joints between the world and a body, from the body upwards."""
        names = list[str]()
        while body:
            first = int(self.mj.body_jntadr[body])
            names += [self.mj.joint(first + i).name for i in reversed(range(int(self.mj.body_jntnum[body])))]
            body = int(self.mj.body_parentid[body])
        return names

    def shape(self, body: str) -> int:
        """Id of the largest geom of a body that has any."""
        geoms = np.flatnonzero(self.mj.geom_bodyid == self.body(body))
        return int(geoms[np.argmax(self.mj.geom_rbound[geoms])])

    def site(self, name: str) -> int:
        """A site's id."""
        return int(self.mj.site(name).id)

    def nominal_qpos(self) -> FloatArray:
        """(nq,) the nominal posture, upright, the soles on the plane z = 0."""
        qpos: FloatArray = self.mj.qpos0.copy()
        qpos[:7] = (0.0, 0.0, self.robot.tables.nominal_base_height, 1.0, 0.0, 0.0, 0.0)
        qpos[self.qpos] = self.robot.nominal_posture[self.joint_indices]
        for joint, angle in self._resting:
            qpos[joint] = angle
        return qpos


def robot_spec(robot: RobotDescription, shapes: Shapes, *, passive: bool = False) -> mujoco.MjSpec:
    """The robot alone, not compiled, with its limits, armature and damping as ``robot.yaml`` says.

    Args:
        robot: the robot's description.
        shapes: which geoms to keep: those that collide, also those that are only seen, or none.
        passive: whether joints that nothing drives move, where robot.yaml has them simulated; else they are fixed.

    Raises:
        ConfigurationError: ``model.xml`` cannot be read, or its joints are not those of ``robot.yaml``.
    """
    file = robot.model_file
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
    for mesh in list(spec.meshes):  # reading those of no shape would take seconds
        if (mesh.name or Path(mesh.file).stem) not in used:
            spec.delete(mesh)
    spec.option.timestep = robot.tables.physics_step
    return spec


def controller_model(robot: RobotDescription) -> Model:
    """What the Whole-Body Controller computes with: the joints outside its groups welded, arms weighing as calibrated.

    Only what is kept apart (``self_collision``) has shapes.

    Raises:
        ConfigurationError: as of ``robot_spec``, or the calibration does not fit the robot.
    """
    spec = robot_spec(robot, "collision")
    _weigh(spec, robot)
    apart = {body for pair in robot.tables.self_collision.pairs for body in pair}
    for geom in list(spec.geoms):
        if geom.parent.name not in apart:
            spec.delete(geom)
    moved = {name for group in WHOLE_BODY_GROUPS for name in robot.tables.group(group)}
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE and joint.name not in moved:
            _weld(spec, joint, robot.tables.nominal_posture.get(joint.name, 0.0))
    return Model(robot, compiled(robot, spec))


def full_model(robot: RobotDescription, shapes: Shapes = "none") -> Model:
    """The nominal model with every joint, for kinematics, tf and pictures."""
    return Model(robot, compiled(robot, robot_spec(robot, shapes)))


def compiled(robot: RobotDescription, spec: mujoco.MjSpec) -> mujoco.MjModel:
    try:
        return spec.compile()
    except ValueError as error:
        raise compile_fault(robot, str(error)) from None


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
    """Weld joints that nothing drives where they rest, and take away what coupled them."""
    if not fixed:
        return
    for equality in list(spec.equalities):
        if fixed.intersection(coupled(spec, equality)):
            spec.delete(equality)
    for joint in list(spec.joints):
        if joint.name in fixed:
            _weld(spec, joint, robot.tables.passive[joint.name].at)


def _weld(spec: mujoco.MjSpec, joint: mujoco.MjsJoint, angle: float) -> None:
    """Take a hinge away, leaving its body turned by ``angle`` [rad] about it."""
    body = joint.parent
    turn, orientation = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, joint.axis / np.linalg.norm(joint.axis), angle)
    mujoco.mju_mulQuat(orientation, body.quat, turn)
    # The hinge's anchor stays where it is: p + R·a = p' + R·Rot(angle)·a.
    before, after = np.zeros(3), np.zeros(3)
    mujoco.mju_rotVecQuat(before, joint.pos, body.quat)
    mujoco.mju_rotVecQuat(after, joint.pos, orientation)
    body.pos = body.pos + before - after
    body.quat = orientation
    spec.delete(joint)


def _indices(places: Iterable[int]) -> Indices:
    indices = np.fromiter(places, dtype=np.intp)
    if indices.size and np.array_equal(indices, np.arange(indices[0], indices[0] + indices.size)):
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices
