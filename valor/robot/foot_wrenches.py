"""Wrenches of the feet of a robot without force/torque sensors in them, from the torques of its legs and its IMU.

Seen from the pelvis, a leg is an arm of six joints under gravity, whose direction u the IMU measures. The ground causes
what the motion does not explain:

    Jᵀ·w = M(q)·q̈ + h(q, q̇, ω, u) − τ        J: the sole's, relative to the pelvis

All inputs pass one low-pass, whose rate is q̈: to first order the observer of generalised momentum (De Luca et al.
2006). Near a straight knee J is singular, so its inverse is damped. The pelvis' linear acceleration is neglected: the
samples of an accelerometer at touchdown disturb more (DCM error of a walk, ESCHER: 8.7 mm instead of 5.6). Friction and
errors of the masses leave 2 to 3 % of the weight on a foot in the air, so small forces count as none.
"""

from collections.abc import Callable, Sequence

import casadi as ca
import mujoco
import numpy as np
from msgspec.structs import replace

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel, pieces
from valor.common.messages import Proprioceptor
from valor.robot.checks.tables import REQUIRED_GROUPS
from valor.robot.description import RobotDescription
from valor.robot.model import Model, compiled, robot_spec, weld_others

BANDWIDTH = 30.0  # of the low-pass [Hz]
LOADED = (0.08, 0.12)  # vertical force up to which there is none, and from which it is as estimated, by the weight
DAMPING = 0.012  # of the inverse, as a singular value by the leg's length; 0.2 is that of a bent knee
LONGEST_GAP = 20_000_000  # longest period that is filtered; after a longer one the filter starts again [ns]


def completion(robot: RobotDescription) -> Callable[[Proprioceptor], Proprioceptor]:
    """Return what adds to each Proprioceptor, in their order, the quantities that no sensor of the robot measures."""
    if robot.tables.feet_are_sensed and robot.tables.imu.accelerometer:
        return lambda proprioceptor: proprioceptor
    return Unsensed(robot).completed


class Unsensed:
    """Estimates the wrenches of feet without sensors and, of an IMU without an accelerometer, the specific force."""

    def __init__(self, robot: RobotDescription) -> None:
        """Raises ConfigurationError: the model is invalid."""
        tables = self._tables = robot.tables
        spec = robot_spec(robot, "none")
        weld_others(spec, robot, REQUIRED_GROUPS)
        model = Model(robot, compiled(robot, spec))
        self._mj, self._data = mj, data = model.mj, mujoco.MjData(model.mj)
        self._gravity = -float(mj.opt.gravity[2])
        mj.opt.gravity[:] = 0.0  # the pelvis is at rest: gravity is its acceleration upwards
        data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        imu, feet = model.site(tables.imu.site), (tables.feet.left, tables.feet.right)
        self._weight = self._gravity * float(mj.body_subtreemass[model.body(tables.base)])
        self._mounting = rotation.quaternion(mj.site_quat[imu])
        self._soles = [model.site(foot.sole) for foot in feet]
        names = [name for group in REQUIRED_GROUPS for name in tables.group(group)]
        self._joints = [robot.index[name] for name in names]
        self._qpos = [int(mj.joint(name).qposadr[0]) for name in names]
        self._dofs = [int(mj.joint(name).dofadr[0]) for name in names]
        self._time: int | None = None
        n = len(names)
        self._measured, self._dt = np.zeros(2 * n + 6), np.zeros(1)
        self._low, self._next, self._rates = np.zeros(2 * n + 6), np.zeros(2 * n + 6), np.zeros(2 * n + 6)
        self._forces, self._jacobian, self._wrenches = np.zeros(mj.nv), np.zeros((12, mj.nv)), np.zeros(12)
        self._filter = Kernel(
            "leg_motion",
            self._motion,
            (self._low, self._measured, self._dt),
            (self._next, self._rates, data.qvel, data.qacc),
        )
        self._solve = Kernel(
            "foot_wrenches",
            self._felt,
            (self._next, self._rates, self._forces, self._jacobian, data.site_xmat),
            (self._wrenches,),
        )

    def completed(self, proprioceptor: Proprioceptor) -> Proprioceptor:
        """Return a Proprioceptor with estimates of what is not measured."""
        up = np.array(rotation.vertical(rotation.quaternion(proprioceptor.imu_orientation)))
        if not self._tables.imu.accelerometer:
            proprioceptor = replace(proprioceptor, imu_linear_acceleration=self._gravity * up)
        if self._tables.feet_are_sensed:
            return proprioceptor
        self._estimate(proprioceptor, up)
        left, right = self._wrenches[:6].copy(), self._wrenches[6:].copy()
        return replace(proprioceptor, left_foot_wrench=left, right_foot_wrench=right)

    def _estimate(self, measured: Proprioceptor, up: FloatArray) -> None:
        """Write the wrenches; ``up`` is the vertical (3,) in the IMU."""
        velocity, effort = measured.joint_velocity[self._joints], measured.joint_effort[self._joints]
        np.concatenate((velocity, effort, measured.imu_angular_velocity, up), out=self._measured)
        passed = 0 if self._time is None else measured.time - self._time
        self._time = measured.time
        known = 0 < passed <= LONGEST_GAP
        self._low[:] = self._next if known else self._measured
        self._dt[0] = 1e-9 * (passed if known else LONGEST_GAP)
        self._filter()
        mj, data = self._mj, self._data
        data.qpos[self._qpos] = measured.joint_position[self._joints]
        mujoco.mj_kinematics(mj, data)
        mujoco.mj_comPos(mj, data)
        mujoco.mj_comVel(mj, data)
        mujoco.mj_rne(mj, data, 1, self._forces)
        for row, site in zip((0, 6), self._soles, strict=True):
            mujoco.mj_jacSite(mj, data, self._jacobian[row : row + 3], self._jacobian[row + 3 : row + 6], site)
        self._solve()

    def _motion(self, low: Expression, measured: Expression, dt: Expression) -> Sequence[Expression]:
        """Filtered measurements, their rates, and the model's velocity and acceleration in the pelvis' axes."""
        change = (measured - low) * (1.0 - ca.exp(-2.0 * np.pi * BANDWIDTH * dt))
        after, rates = low + change, change / dt
        n, mounting = len(self._dofs), ca.DM(rotation.rows(self._mounting))
        velocity, _, spin, up = pieces(after, (n, n, 3, 3))
        acceleration, _, spinning, _ = pieces(rates, (n, n, 3, 3))
        qvel, qacc = ca.SX(self._mj.nv, 1), ca.SX(self._mj.nv, 1)
        qvel[3:6], qvel[self._dofs] = mounting @ spin, velocity
        qacc[:3], qacc[3:6], qacc[self._dofs] = self._gravity * mounting @ up, mounting @ spinning, acceleration
        return after, rates, qvel, qacc

    def _felt(
        self, after: Expression, rates: Expression, forces: Expression, jacobian: Expression, axes: Expression
    ) -> Sequence[Expression]:
        """(12,) wrenches of the left and right foot in their soles [N, N·m]."""
        n, dofs = len(self._dofs), self._dofs
        armature, damping = ca.DM(self._mj.dof_armature[dofs]), ca.DM(self._mj.dof_damping[dofs])
        missing = forces[dofs] + armature * rates[:n] + damping * after[:n] - after[n : 2 * n]
        leg, up, wrenches = self._tables.size.leg, ca.DM(rotation.rows(self._mounting)) @ after[2 * n + 3 :], []
        none, loaded = LOADED
        units = ca.diag((1.0, 1.0, 1.0, leg, leg, leg))  # a moment becomes a force at the leg's length
        for foot, site in enumerate(self._soles):
            own = slice(6 * foot, 6 * foot + 6)
            scaled = units @ jacobian[own, dofs[own]]
            squares = scaled @ scaled.T + (DAMPING * leg) ** 2 * ca.SX.eye(6)
            wrench = units @ ca.ldl_solve(scaled @ missing[own], *ca.ldl(squares))
            turn = ca.reshape(axes[site, :], 3, 3)  # from the pelvis' axes
            load = ca.dot(up, wrench[:3]) / self._weight
            wrench *= ca.fmin(1.0, ca.fmax(0.0, (load - none) / (loaded - none)))
            wrenches += [turn @ wrench[:3], turn @ wrench[3:]]
        return (ca.vertcat(*wrenches),)
