"""Kinematics and dynamics of the reduced model, from a few MuJoCo calls.

Everything is evaluated with the pelvis at the origin and without linear velocity, in the axes of odom: mass matrix,
bias forces, Jacobians and their drift depend on neither (homogeneity of space, Galilei). They are therefore evaluated
once for estimator and controller, before the pelvis position is estimated.

Equations of motion, pelvis rows first (linear in odom, angular in pelvis), with contact forces f at the soles:

    M(q)·v̇ + h(q, v) = Sᵀ·τ + Jᵀ·f

The motions that tasks use are defined in ``motion``.
"""

from collections.abc import Sequence

import casadi as ca
import mujoco
import numpy as np
import numpy.typing as npt

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel, parts
from valor.common.rotation import Quaternion
from valor.robot.model import Indices, Model
from valor.whole_body.model.motion import FEET, Base, Motions


class ModelJoints:
    """Joints of the reduced model, in the order of its degrees of freedom."""

    def __init__(self, model: Model) -> None:
        count = model.mj.nv - 6
        of_dof = np.zeros(model.mj.nv, dtype=np.intp)
        of_dof[model.dof] = np.arange(len(model.robot.joints), dtype=np.intp)[model.joint_indices]
        self.count = count
        self.indices: list[int] = of_dof[6:].tolist()  # the same as a list
        first, last = self.indices[0], self.indices[-1] + 1
        contiguous = self.indices == list(range(first, last))
        self.places: Indices = slice(first, last) if contiguous else np.array(self.indices)  # in joint vectors
        self.names = tuple(model.robot.joints[place] for place in self.indices)  # their names
        self._robot = model.robot

    def group(self, *groups: str) -> npt.NDArray[np.intp]:
        """Return the indices of the model's joints that belong to the groups."""
        members = np.concatenate([self._robot.group_indices(group) for group in groups])
        return np.flatnonzero(np.isin(self.indices, members))


class Dynamics:
    """Reduced model at one state; ``sole_dofs`` move each sole relative to the pelvis position.

    ``task_velocity`` is jacobian·velocity, relative to the pelvis' linear velocity.
    """

    def __init__(self, model: Model, motions: Motions) -> None:
        """Create the model with these motions; that of the soles is named ``FEET``."""
        tables, mj = model.robot.tables, model.mj
        self.joints = ModelJoints(model)  # the model's joints
        self._model = mj
        self._data = data = mujoco.MjData(mj)
        base = model.body(tables.base)
        soles = (model.site(tables.feet.left.sole), model.site(tables.feet.right.sole))
        self.mass = float(mj.body_subtreemass[base])  # [kg]
        self.gravity = -float(mj.opt.gravity[2])  # [m/s²]
        nv = mj.nv
        self.mass_matrix = np.zeros((nv, nv))  # (nv, nv)
        self.bias = np.zeros(nv)  # (nv,) Coriolis, centrifugal and gravity forces
        self.rows, self._motions = motions.rows, motions  # rows of each motion, by name
        self.jacobian = np.zeros((motions.count, nv))  # (count, nv); motions accelerate by jacobian·v̇ + drift
        self.drift, self.task_velocity = np.zeros(motions.count), np.zeros(motions.count)  # (count,)
        self.poses = np.zeros(motions.size)  # (size,) of the motions that have a pose
        self.rotation = np.eye(3)  # (3, 3) pelvis in odom
        self.joint_position: FloatArray = data.qpos[7:]  # (nj,) of the model's joints [rad]
        self.joint_velocity: FloatArray = data.qvel[6:]  # (nj,) [rad/s]
        self.velocity: FloatArray = data.qvel  # (nv,) of the model, its linear part zero
        self.com: FloatArray = data.subtree_com[base]  # (3,) from the pelvis, in odom's axes [m]
        of_soles = self.poses[motions.poses[FEET]]
        self.sole_position: FloatArray = of_soles[:6].reshape(2, 3)  # from the pelvis, in odom's axes [m]
        self.sole_rotation: FloatArray = of_soles[6:].reshape(2, 3, 3)  # in odom
        self.configuration: FloatArray = data.qpos[3:]  # (4 + nj,) input: pelvis orientation in odom, joints
        self.rates: FloatArray = data.qvel[3:]  # (3 + nj,) input: angular velocity of the pelvis in pelvis, joints
        self.sole_dofs = tuple(self._moving(int(mj.site_bodyid[site])) for site in soles)
        self._jacobians = motions.calls(data, self.jacobian)
        own = (self.jacobian[rows] for rows in motions.in_kernel)
        self._accelerations = Kernel(
            "accelerations",
            self._expressions,
            (data.qpos[3:7], self.mass_matrix[:6], self.bias[:6], self.com, data.qvel, *motions.inputs(data)),
            (self.rotation, self.drift, self.task_velocity, self.poses, *own),
        )
        data.qpos[:] = 0.0
        data.qpos[3] = 1.0

    def update(
        self, orientation: Quaternion, angular_velocity: FloatArray, position: FloatArray, velocity: FloatArray
    ) -> None:
        """Evaluate everything at a pelvis orientation in odom and (3,) angular velocity in pelvis [rad/s].

        ``position`` and ``velocity`` are (nj,) of the model's joints [rad, rad/s].
        """
        self.configuration[:4] = orientation
        self.configuration[4:] = position
        self.rates[:3] = angular_velocity
        self.rates[3:] = velocity
        self.evaluate()

    def evaluate(self) -> None:
        """Evaluate everything at ``configuration`` and ``rates``."""
        m, d = self._model, self._data
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_crb(m, d)
        mujoco.mj_comVel(m, d)
        mujoco.mj_rne(m, d, 0, self.bias)
        mujoco.mj_rnePostConstraint(m, d)  # accelerations of bodies at v̇ = 0: the Jacobians' drift
        mujoco.mj_fullM(m, d, self.mass_matrix)
        for write in self._jacobians:
            write()
        self._accelerations()

    def nearest(self, one: int, other: int, reach: float, segment: FloatArray) -> float:
        """Return the distance of two geoms, at most ``reach``; write their nearest points to (6,) ``segment`` [m]."""
        return float(mujoco.mj_geomDistance(self._model, self._data, one, other, reach, segment))

    def point_jacobian(self, geom: int, point: FloatArray, rows: FloatArray, rates: FloatArray) -> None:
        """Write the Jacobian of a point on a geom's body to (3, nv) ``rows``, its time derivative to ``rates``."""
        body = self._model.geom_bodyid[geom]
        mujoco.mj_jac(self._model, self._data, rows, None, point, body)
        mujoco.mj_jacDot(self._model, self._data, rates, None, point, body)

    def _moving(self, body: int) -> list[int]:
        m = self._model
        dofs: list[int] = []
        while body > 0:
            first = int(m.body_dofadr[body])
            dofs += range(first, first + int(m.body_dofnum[body])) if first >= 0 else ()
            body = int(m.body_parentid[body])
        return sorted(dof for dof in dofs if dof >= 3)

    def _expressions(self, orientation: Expression, *given: Expression) -> Sequence[Expression]:
        """Rotation of the pelvis; drifts, velocities, poses and some Jacobians of the motions."""
        mass_rows, bias, com, rates, *inputs = given
        up = ca.vertcat(0.0, 0.0, self.gravity)
        turned = ca.vertcat(*(ca.horzcat(*row) for row in rotation.rows(parts(orientation))))
        return turned, *self._motions.find(Base(turned, mass_rows, bias, com, rates, up, self.mass), inputs)


class UpperBodyKinematics:
    """Effect of the commanded arms on CoM and chest: the model with a level pelvis at the origin and nominal legs.

    A controller that only keeps the CoM moves the torso back when an arm goes forward (thesis 5.3). The CoM reference
    therefore moves as the arms would move the CoM with legs and pelvis frozen; the torso stays.
    """

    def __init__(self, model: Model) -> None:
        robot = model.robot
        joints = ModelJoints(model)
        self._model = model.mj
        self._data = data = mujoco.MjData(model.mj)
        self._legs = joints.group("left_leg", "right_leg")
        self._upper = joints.group("torso", "left_arm", "right_arm")
        self._nominal: FloatArray = robot.nominal_posture[joints.places]
        data.qpos[:] = 0.0
        data.qpos[3] = 1.0
        data.qpos[7:] = self._nominal
        self.com: FloatArray = data.subtree_com[model.body(robot.tables.base)]  # (3,) in pelvis, now [m]
        self.chest: FloatArray = data.xmat[model.body(robot.tables.chest)].reshape(3, 3)  # (3, 3) in pelvis
        self._evaluate()
        self.nominal_com = self.com.copy()  # (3,) in the nominal posture [m]
        feet = robot.tables.feet
        soles = [data.site_xpos[model.site(foot.sole)][2] for foot in (feet.left, feet.right)]
        self.nominal_com_height = float(self.com[2] - np.mean(soles))  # above the soles [m]
        self._places = 7 + self._upper
        self._last = b""

    def update(self, position: FloatArray) -> None:
        """Move the upper body to (nj,) positions of the model's joints [rad]; those of the legs are ignored."""
        upper = position[self._upper]
        if (numbers := upper.tobytes()) != self._last:
            self._last = numbers
            self._data.qpos[self._places] = upper
            self._evaluate()

    def _evaluate(self) -> None:
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
