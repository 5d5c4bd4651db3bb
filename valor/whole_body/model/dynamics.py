"""Kinematics and dynamics of the reduced model, from a handful of MuJoCo calls.

Everything here is evaluated with the pelvis at the origin and without linear velocity, in odom's axes: mass matrix,
bias forces, Jacobians and their drift do not change with either (homogeneity of space, Galilei), so they can be had
before the estimator knows where the pelvis is, once for estimator and controller.

The equations of motion, pelvis rows first (linear in odom, angular in pelvis), with contact forces f at the soles:

    M(q)·v̇ + h(q, v) = Sᵀ·τ + Jᵀ·f

What tasks want something of is in ``motion``.
"""

from __future__ import annotations

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
    """The joints that the reduced model has, in the order of its degrees of freedom.

    Attributes:
        places: of them in every joint vector of the robot; a slice, so that indexing costs nothing, if they are
            contiguous there.
        indices: the same, one by one.
    """

    def __init__(self, model: Model) -> None:
        count = model.mj.nv - 6
        of_dof = np.zeros(model.mj.nv, dtype=np.intp)
        of_dof[model.dof] = np.arange(len(model.robot.joints), dtype=np.intp)[model.joint_indices]
        self.count = count
        self.indices: list[int] = of_dof[6:].tolist()
        first, last = self.indices[0], self.indices[-1] + 1
        contiguous = self.indices == list(range(first, last))
        self.places: Indices = slice(first, last) if contiguous else np.array(self.indices)
        self._robot = model.robot

    @property
    def names(self) -> tuple[str, ...]:
        """Of the joints."""
        return tuple(self._robot.joints[place] for place in self.indices)

    def group(self, *groups: str) -> npt.NDArray[np.intp]:
        """Which of the model's joints belong to the groups."""
        members = np.concatenate([self._robot.group_indices(group) for group in groups])
        return np.flatnonzero(np.isin(self.indices, members))


class Dynamics:
    """The reduced model at one state.

    Attributes:
        joints: the model's joints.
        mass: [kg]. gravity: [m/s²].
        joint_position: (nj,) [rad]; joint_velocity: (nj,) [rad/s], of the model's joints.
        velocity: (nv,) of the model, its linear part zero.
        rotation: (3, 3) pelvis in odom.
        mass_matrix: (nv, nv). bias: (nv,) Coriolis, centrifugal and gravity forces.
        com: (3,) from the pelvis, in odom's axes [m].
        rows: of each motion, by name.
        jacobian: (count, nv), drift: (count,): acceleration = jacobian·v̇ + drift of the motions.
        task_velocity: (count,) = jacobian·velocity: relative to the pelvis' linear velocity.
        poses: (size,) of the motions that have one.
        sole_position: (2, 3) from the pelvis, in odom's axes [m]. sole_rotation: (2, 3, 3) in odom.
        configuration: (4 + nj,) orientation of the pelvis in odom, then joint_position; to be written before
            ``evaluate``. rates: (3 + nj,) angular velocity of the pelvis in pelvis, then joint_velocity; likewise.
        sole_dofs: of each sole, the degrees of freedom that move it from the pelvis' place: the pelvis' rotation and
            the leg's joints. Its other columns of the Jacobian are zero, but for the pelvis' linear ones.
    """

    def __init__(self, model: Model, motions: Motions) -> None:
        """Evaluate these motions, among them the soles' by the name ``FEET``."""
        tables, mj = model.robot.tables, model.mj
        self.joints = ModelJoints(model)
        self._model = mj
        self._data = data = mujoco.MjData(mj)
        base = model.body(tables.base)
        soles = (model.site(tables.feet.left.sole), model.site(tables.feet.right.sole))
        self.mass = float(mj.body_subtreemass[base])
        self.gravity = -float(mj.opt.gravity[2])
        nv = mj.nv
        self.mass_matrix = np.zeros((nv, nv))
        self.bias = np.zeros(nv)
        self.rows, self._motions = motions.rows, motions
        self.jacobian = np.zeros((motions.count, nv))
        self.drift, self.task_velocity = np.zeros(motions.count), np.zeros(motions.count)
        self.poses = np.zeros(motions.size)
        self.rotation = np.eye(3)
        self.joint_position: FloatArray = data.qpos[7:]
        self.joint_velocity: FloatArray = data.qvel[6:]
        self.velocity: FloatArray = data.qvel
        self.com: FloatArray = data.subtree_com[base]
        of_soles = self.poses[motions.poses[FEET]]
        self.sole_position: FloatArray = of_soles[:6].reshape(2, 3)
        self.sole_rotation: FloatArray = of_soles[6:].reshape(2, 3, 3)
        self.configuration: FloatArray = data.qpos[3:]
        self.rates: FloatArray = data.qvel[3:]
        self.sole_dofs = tuple(self._moving(int(mj.site_bodyid[site])) for site in soles)
        self._jacobians = motions.calls(data, self.jacobian)
        self._accelerations = Kernel(
            "accelerations",
            self._expressions,
            (data.qpos[3:7], self.mass_matrix[:6], self.bias[:6], self.com, data.qvel, *motions.inputs(data)),
            (
                self.rotation,
                self.drift,
                self.task_velocity,
                self.poses,
                *(self.jacobian[rows] for rows in motions.in_kernel),
            ),
        )
        data.qpos[:] = 0.0
        data.qpos[3] = 1.0

    def update(
        self, orientation: Quaternion, angular_velocity: FloatArray, position: FloatArray, velocity: FloatArray
    ) -> None:
        """Evaluate everything.

        Args:
            orientation: of the pelvis in odom.
            angular_velocity: (3,) of the pelvis in pelvis [rad/s].
            position: (nj,) of the model's joints [rad].
            velocity: (nj,) [rad/s].
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
        """The distance between two geoms [m], negative where they overlap; ``reach`` if they are farther apart.

        Args:
            one: a geom's id.
            other: likewise.
            reach: farther than which nothing is looked for [m].
            segment: (6,) written to: the nearest points of both, from the pelvis, in odom's axes [m].
        """
        return float(mujoco.mj_geomDistance(self._model, self._data, one, other, reach, segment))

    def point_jacobian(self, geom: int, point: FloatArray, rows: FloatArray, rates: FloatArray) -> None:
        """Of a point on a geom's body: (3, nv) ``rows`` and their time derivative ``rates`` are written to."""
        body = self._model.geom_bodyid[geom]
        mujoco.mj_jac(self._model, self._data, rows, None, point, body)
        mujoco.mj_jacDot(self._model, self._data, rates, None, point, body)

    def _moving(self, body: int) -> list[int]:
        """The degrees of freedom that move a body, but for the pelvis' linear ones."""
        m = self._model
        dofs: list[int] = []
        while body > 0:
            first = int(m.body_dofadr[body])
            dofs += range(first, first + int(m.body_dofnum[body])) if first >= 0 else ()
            body = int(m.body_parentid[body])
        return sorted(dof for dof in dofs if dof >= 3)

    def _expressions(
        self,
        orientation: Expression,
        mass_rows: Expression,
        bias: Expression,
        com: Expression,
        rates: Expression,
        *inputs: Expression,
    ) -> Sequence[Expression]:
        """Rotation of the pelvis, then drifts, velocities, poses and some of the Jacobians of the motions."""
        up = ca.vertcat(0.0, 0.0, self.gravity)
        turned = ca.vertcat(*(ca.horzcat(*row) for row in rotation.rows(parts(orientation))))
        return turned, *self._motions.find(Base(turned, mass_rows, bias, com, rates, up, self.mass), inputs)
