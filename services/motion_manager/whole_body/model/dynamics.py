"""Kinematics and dynamics of the reduced model, from a handful of MuJoCo calls.

Everything here is evaluated with the pelvis at the origin and without linear velocity, in odom's axes: mass matrix,
bias forces, Jacobians and their drift do not change with either (homogeneity of space, Galilei), so they can be had
before the estimator knows where the pelvis is, once for estimator and controller.

The equations of motion, pelvis rows first (linear in odom, angular in pelvis), with contact forces f at the soles:

    M(q)·v̇ + h(q, v) = Sᵀ·τ + Jᵀ·f

The centroidal quantities are in the pelvis rows already (Orin & Goswami 2008; Wensing & Orin 2016): with r the CoM
from the pelvis and R the pelvis' rotation,

    m·c̈ = M₀₋₂·v̇ + h₀₋₂ + m·g,    k̇ = R·(M₃₋₅·v̇ + h₃₋₅) − r×(M₀₋₂·v̇ + h₀₋₂)
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import mujoco
import numpy as np
import numpy.typing as npt

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.rotation import Quaternion
from valor.motion_manager.kernel import Expression, Kernel, by_rows, parts
from valor.robot.model import Indices, Model

# Rows of ``Dynamics.jacobian`` and ``Dynamics.drift``.
COM = slice(0, 3)  # c̈
MOMENTUM = slice(3, 6)  # k̇, about the CoM
CHEST = slice(6, 9)  # angular acceleration
PELVIS = slice(9, 12)  # angular acceleration
SOLES = slice(12, 24)  # left linear, left angular, right linear, right angular
ROWS = 24


def sole_rows(foot: int) -> slice:
    """Of one sole (0 left, 1 right): linear, then angular."""
    return slice(12 + 6 * foot, 18 + 6 * foot)


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
        jacobian: (24, nv), drift: (24,): acceleration = jacobian·v̇ + drift of what the row slices name.
        sole_position: (2, 3) from the pelvis, in odom's axes [m]. sole_rotation: (2, 3, 3) in odom.
        chest_rotation: (3, 3) in odom.
        task_velocity: (24,) = jacobian·velocity: CoM and sole velocities relative to the pelvis' linear velocity.
        configuration: (4 + nj,) orientation of the pelvis in odom, then joint_position; to be written before
            ``evaluate``. rates: (3 + nj,) angular velocity of the pelvis in pelvis, then joint_velocity; likewise.
        sole_dofs: of each sole, the degrees of freedom that move it from the pelvis' place: the pelvis' rotation and
            the leg's joints. Its other columns of the Jacobian are zero, but for the pelvis' linear ones.
    """

    def __init__(self, model: Model) -> None:
        tables, mj = model.robot.tables, model.mj
        self.joints = ModelJoints(model)
        self._model = mj
        self._data = data = mujoco.MjData(mj)
        self._base = model.body(tables.base)
        self._chest = model.body(tables.chest)
        self._soles = (model.site(tables.feet.left.sole), model.site(tables.feet.right.sole))
        self.mass = float(mj.body_subtreemass[self._base])
        self.gravity = -float(mj.opt.gravity[2])
        nv = mj.nv
        self.mass_matrix = np.zeros((nv, nv))
        self.bias = np.zeros(nv)
        self.jacobian = np.zeros((ROWS, nv))
        self.jacobian[PELVIS, 3:6] = np.eye(3)
        self.drift = np.zeros(ROWS)
        self.task_velocity = np.zeros(ROWS)
        self.rotation = np.eye(3)
        self.joint_position: FloatArray = data.qpos[7:]
        self.joint_velocity: FloatArray = data.qvel[6:]
        self.velocity: FloatArray = data.qvel
        self.com: FloatArray = data.subtree_com[self._base]
        self.chest_rotation: FloatArray = data.xmat[self._chest].reshape(3, 3)
        self.sole_position = np.zeros((2, 3))
        self.sole_rotation = np.zeros((2, 3, 3))
        self.configuration: FloatArray = data.qpos[3:]
        self.rates: FloatArray = data.qvel[3:]
        self.sole_dofs = tuple(self._moving(int(mj.site_bodyid[site])) for site in self._soles)
        self._linear = tuple(self.jacobian[12 + 6 * i : 15 + 6 * i] for i in range(2))
        self._angular = tuple(self.jacobian[15 + 6 * i : 18 + 6 * i] for i in range(2))
        self._chest_rows = self.jacobian[CHEST]
        bodies = [self._chest, *(int(mj.site_bodyid[site]) for site in self._soles)]
        self._accelerations = Kernel(
            "accelerations",
            self._expressions,
            (
                data.qpos[3:7],
                self.mass_matrix[:6],
                self.bias[:6],
                self.com,
                data.qvel,
                *(data.cacc[body] for body in bodies),
                *(data.cvel[body] for body in bodies),
                *(data.site_xpos[site] for site in self._soles),
                *(data.site_xmat[site] for site in self._soles),
            ),
            (
                self.rotation,
                self.jacobian[:6],
                self.jacobian[PELVIS],
                self.drift,
                self.task_velocity,
                self.sole_position,
                self.sole_rotation,
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
        mujoco.mj_jacBody(m, d, None, self._chest_rows, self._chest)
        for i, site in enumerate(self._soles):
            mujoco.mj_jacSite(m, d, self._linear[i], self._angular[i], site)
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
        *bodies: Expression,
    ) -> Sequence[Expression]:
        """Rotations, centroidal rows, drifts and velocities of what MuJoCo has found.

        Args:
            orientation: (4,) of the pelvis in odom.
            mass_rows: (6, nv) of the pelvis.
            bias: (6,) likewise.
            com: (3,) from the pelvis.
            rates: (nv,) velocity of the model, its linear part zero.
            bodies: of chest, left and right foot, (6,) spatial accelerations at v̇ = 0, as MuJoCo has them: angular,
                linear at the CoM; likewise velocities; of the left and the right sole, (3,) places and (9,) rotations.
        """
        chest_acceleration, left_acceleration, right_acceleration, chest_velocity, *soles = bodies
        up = ca.vertcat(0.0, 0.0, self.gravity)  # MuJoCo accelerates the world upwards in gravity's place
        turned = ca.vertcat(*(ca.horzcat(*row) for row in rotation.rows(parts(orientation))))
        linear, linear_bias = mass_rows[:3, :], bias[:3]
        lever = ca.skew(com)
        momentum = turned @ mass_rows[3:, :] - lever @ linear
        drift = [linear_bias / self.mass - up, turned @ bias[3:] - lever @ linear_bias]
        drift += [chest_acceleration[:3], ca.SX.zeros(3)]
        pushed = linear @ rates
        velocities = [pushed / self.mass, turned @ (mass_rows[3:, :] @ rates) - lever @ pushed]
        velocities += [chest_velocity[:3], turned @ rates[3:6]]
        accelerations = (left_acceleration, right_acceleration)
        for acceleration, velocity, place in zip(accelerations, soles[:2], soles[2:4], strict=True):
            arm, turning = place - com, velocity[:3]
            moving = velocity[3:] + ca.cross(turning, arm)
            velocities += [moving, turning]
            at_sole = acceleration[3:] + ca.cross(acceleration[:3], arm) + ca.cross(turning, moving)
            drift += [at_sole - up, acceleration[:3]]
        pelvis = ca.horzcat(ca.SX(3, 3), turned, ca.SX(3, self.velocity.size - 6))
        rotations = (by_rows(numbers) for numbers in soles[4:])
        return (
            turned,
            ca.vertcat(linear / self.mass, momentum),
            pelvis,
            ca.vertcat(*drift),
            ca.vertcat(*velocities),
            ca.horzcat(*soles[2:4]).T,
            ca.vertcat(*rotations),
        )
