"""Set-points that the Whole-Body Controller integrates for joints which are not driven by force."""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel, clipped
from valor.control.kinematics import ModelJoints
from valor.robot.description import RobotDescription


class SetPoints:
    """Set-points of the joints that are not driven by force: they integrate the accelerations (thesis 3.4.2)."""

    def __init__(self, robot: RobotDescription, joints: ModelJoints) -> None:
        nj, n = joints.count, len(robot.joints)
        self._indices, self._joints = joints.indices, n
        self.integrated = np.array([robot.tables.joints[name].control != "force" for name in joints.names])
        self._lower, self._upper = robot.lower[joints.places], robot.upper[joints.places]
        self._now = np.zeros((2, nj))
        self.position, self.velocity = self._now  # (nj,) of the model's joints [rad, rad/s]
        self._solved = np.zeros(6 + 2 * nj + n)
        self._dt = np.zeros(1)
        self._next = np.zeros((2, nj))
        self._sent = np.zeros((4, n))
        self._integrate = Kernel(
            "set_points",
            self._expressions,
            (self._solved, self._dt, self.position, self.velocity),
            (self._next, self._sent),
        )

    def reset(self, position: FloatArray) -> None:
        """Start at rest at (nj,) ``position`` [rad], clamped to the limits."""
        self.position[:] = np.clip(position, self._lower, self._upper)
        self.velocity[:] = 0.0

    def advance(
        self, acceleration: FloatArray, torque: FloatArray, measured: FloatArray, dt: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Integrate (nv,) accelerations over ``dt`` [s], with (nj,) torques [N·m] and (n,) measured positions [rad].

        Returns (n,) efforts [N·m] and accelerations [rad/s²], zero outside the model, and (n,) set-points of position
        and velocity [rad, rad/s], the measured position and zero for joints without set-points.
        """
        np.concatenate((acceleration, torque, measured), out=self._solved)
        self._dt[0] = dt
        self._integrate()
        self._now[:] = self._next
        effort, joint_acceleration, position, velocity = self._sent.copy()
        return effort, joint_acceleration, position, velocity

    def _expressions(
        self, solved: Expression, dt: Expression, position: Expression, velocity: Expression
    ) -> Sequence[Expression]:
        nj = position.shape[0]
        accelerations, torques, measured = solved[6 : 6 + nj], solved[6 + nj : 6 + 2 * nj], solved[6 + 2 * nj :]
        velocity = velocity + accelerations * dt
        position = clipped(position + velocity * dt, ca.DM(self._lower), ca.DM(self._upper))
        sent = [ca.SX(self._joints, 1), ca.SX(self._joints, 1), ca.SX(measured), ca.SX(self._joints, 1)]
        led = np.flatnonzero(self.integrated).tolist()
        places = [self._indices[joint] for joint in led]
        sent[0][self._indices], sent[1][self._indices] = torques, accelerations
        sent[2][places], sent[3][places] = position[led], velocity[led]
        return ca.horzcat(position, velocity).T, ca.horzcat(*sent).T
