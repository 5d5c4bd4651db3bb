"""Dynamics of the reduced model, and of the motions that tasks control.

Equations of motion, pelvis rows first (linear in odom, angular in pelvis), with contact forces f at the soles:

    M(q)·v̇ + h(q, v) = Sᵀ·τ + Jᵀ·f
"""

from collections.abc import Sequence

import casadi as ca
import mujoco
import numpy as np

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel, parts
from valor.control.kinematics import Kinematics
from valor.control.motions import Base, Motions


class TaskDynamics:
    """Dynamics at the state of a ``Kinematics``, whose arrays it shares."""

    def __init__(self, kinematics: Kinematics, motions: Motions) -> None:
        self.kinematics = kinematics
        self.joints, self.velocity = kinematics.joints, kinematics.velocity
        self.joint_position, self.joint_velocity = kinematics.joint_position, kinematics.joint_velocity
        self.mass_matrix, self.bias = kinematics.mass_matrix, kinematics.bias
        self.sole_rotation = kinematics.sole_rotation
        self._model, self._data = kinematics.model.mj, kinematics.data
        self._mass, self._gravity = kinematics.mass, kinematics.gravity
        data, nv = self._data, self._model.nv
        self.rows, self._motions = motions.rows, motions  # rows of each motion, by name
        self.jacobian = np.zeros((motions.count, nv))  # (count, nv); motions accelerate by jacobian·v̇ + drift
        # (count,); the velocity is jacobian·velocity, relative to the pelvis' linear velocity.
        self.drift, self.task_velocity = np.zeros(motions.count), np.zeros(motions.count)
        self.poses = np.zeros(motions.size)  # (size,) of the motions that have a pose
        self._jacobians = motions.calls(data, self.jacobian)
        own = (self.jacobian[rows] for rows in motions.in_kernel)
        self._accelerations = Kernel(
            "accelerations",
            self._expressions,
            (data.qpos[3:7], self.mass_matrix[:6], self.bias[:6], kinematics.com, data.qvel, *motions.inputs(data)),
            (self.drift, self.task_velocity, self.poses, *own),
        )

    def evaluate(self) -> None:
        """Evaluate everything, after ``Kinematics.evaluate``."""
        m, d = self._model, self._data
        self.kinematics.evaluate_bias()
        mujoco.mj_rnePostConstraint(m, d)  # accelerations of bodies at v̇ = 0: the Jacobians' drift
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

    def _expressions(self, orientation: Expression, *given: Expression) -> Sequence[Expression]:
        """Drifts, velocities, poses and some Jacobians of the motions."""
        mass_rows, bias, com, rates, *inputs = given
        up = ca.vertcat(0.0, 0.0, self._gravity)
        turned = ca.vertcat(*(ca.horzcat(*row) for row in rotation.rows(parts(orientation))))
        return self._motions.find(Base(turned, mass_rows, bias, com, rates, up, self._mass), inputs)
