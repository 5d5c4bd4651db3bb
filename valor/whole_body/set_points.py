"""What the joints are told: torques, and the set-points that integrate the accelerations (thesis 3.4.2)."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel, clipped
from valor.robot.description import RobotDescription
from valor.whole_body.model.dynamics import ModelJoints


class SetPoints:
    """Set-points of the joints that are not driven by force.

    Attributes:
        position: (nj,) of the model's joints [rad].
        velocity: (nj,) [rad/s].
        integrated: (nj,) which of them are led by set-points.
    """

    def __init__(self, robot: RobotDescription, joints: ModelJoints) -> None:
        nj, n = joints.count, len(robot.joints)
        self._indices, self._joints = joints.indices, n
        self.integrated = np.array([robot.tables.joints[name].control != "force" for name in joints.names])
        self._lower, self._upper = robot.lower[joints.places], robot.upper[joints.places]
        self._now = np.zeros((2, nj))
        self.position, self.velocity = self._now
        self._solved = np.zeros(6 + 2 * nj + n)
        self._dt = np.zeros(1)
        self._next = np.zeros((2, nj))
        self._told = np.zeros((4, n))
        self._integrate = Kernel(
            "set_points",
            self._expressions,
            (self._solved, self._dt, self.position, self.velocity),
            (self._next, self._told),
        )

    def reset(self, position: FloatArray) -> None:
        """At rest at (nj,) ``position`` [rad], or at the limit next to it."""
        self.position[:] = np.clip(position, self._lower, self._upper)
        self.velocity[:] = 0.0

    def advance(
        self, acceleration: FloatArray, torque: FloatArray, measured: FloatArray, dt: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Integrate the accelerations.

        Args:
            acceleration: (nv,) of the model.
            torque: (nj,) [N·m].
            measured: (n,) positions of the robot's joints [rad].
            dt: a period [s].

        Returns:
            (n,) efforts [N·m], accelerations [rad/s²], positions [rad] and velocities [rad/s]: efforts and
            accelerations of the model's joints, zero elsewhere; set-points of those that are led by them, measured
            positions and no velocity elsewhere.
        """
        np.concatenate((acceleration, torque, measured), out=self._solved)
        self._dt[0] = dt
        self._integrate()
        self._now[:] = self._next
        effort, joint_acceleration, position, velocity = self._told.copy()
        return effort, joint_acceleration, position, velocity

    def _expressions(
        self, solved: Expression, dt: Expression, position: Expression, velocity: Expression
    ) -> Sequence[Expression]:
        nj = position.shape[0]
        accelerations, torques, measured = solved[6 : 6 + nj], solved[6 + nj : 6 + 2 * nj], solved[6 + 2 * nj :]
        velocity = velocity + accelerations * dt
        position = clipped(position + velocity * dt, ca.DM(self._lower), ca.DM(self._upper))
        told = [ca.SX(self._joints, 1), ca.SX(self._joints, 1), ca.SX(measured), ca.SX(self._joints, 1)]
        led = np.flatnonzero(self.integrated).tolist()
        places = [self._indices[joint] for joint in led]
        told[0][self._indices], told[1][self._indices] = torques, accelerations
        told[2][places], told[3][places] = position[led], velocity[led]
        return ca.horzcat(position, velocity).T, ca.horzcat(*told).T
