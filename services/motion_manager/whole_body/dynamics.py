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

import mujoco
import numpy as np
import numpy.typing as npt

from motion_manager.whole_body import rotation
from motion_manager.whole_body.rotation import Quaternion
from motion_manager.whole_body.state import FloatArray
from valor_common.model import Indices, Model

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
    """

    def __init__(self, model: Model) -> None:
        count = model.mj.nv - 6
        of_dof = np.zeros(model.mj.nv, dtype=np.intp)
        of_dof[model.dof] = np.arange(len(model.robot.joints), dtype=np.intp)[model.joint_indices]
        self.count = count
        self._indices = of_dof[6:].copy()
        first, last = int(self._indices[0]), int(self._indices[-1]) + 1
        contiguous = np.array_equal(self._indices, np.arange(first, last))
        self.places: Indices = slice(first, last) if contiguous else self._indices
        self._robot = model.robot

    @property
    def names(self) -> tuple[str, ...]:
        """Of the joints."""
        return tuple(self._robot.joints[place] for place in self._indices)

    def group(self, *groups: str) -> npt.NDArray[np.intp]:
        """Which of the model's joints belong to the groups."""
        members = np.concatenate([self._robot.group_indices(group) for group in groups])
        return np.flatnonzero(np.isin(self._indices, members))


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
        self._site_position: FloatArray = data.site_xpos
        self._site_matrix: FloatArray = data.site_xmat.reshape(-1, 3, 3)
        self._chest_drift: FloatArray = data.cacc[self._chest, :3]  # angular part, in odom's axes
        self._site_places = np.array(self._soles)
        self._linear = tuple(self.jacobian[12 + 6 * i : 15 + 6 * i] for i in range(2))
        self._angular = tuple(self.jacobian[15 + 6 * i : 18 + 6 * i] for i in range(2))
        self._chest_rows = self.jacobian[CHEST]
        self._com_rows = self.jacobian[COM]
        self._momentum_rows = self.jacobian[MOMENTUM]
        self._pelvis_rows = self.jacobian[PELVIS, 3:6]
        self._acceleration = np.zeros(6)
        self._cross = np.zeros((3, 3))
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
        m, d = self._model, self._data
        d.qpos[3:7] = orientation
        d.qpos[7:] = position
        d.qvel[3:6] = angular_velocity
        d.qvel[6:] = velocity
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_crb(m, d)
        mujoco.mj_comVel(m, d)
        mujoco.mj_rne(m, d, 0, self.bias)
        mujoco.mj_rnePostConstraint(m, d)  # accelerations of bodies at v̇ = 0: the Jacobians' drift
        mujoco.mj_fullM(m, d, self.mass_matrix)
        rotation.matrix(orientation, self.rotation)
        self._centroidal()
        self._pelvis_rows[:] = self.rotation
        mujoco.mj_jacBody(m, d, None, self._chest_rows, self._chest)
        drift = self.drift
        drift[CHEST] = self._chest_drift
        acceleration = self._acceleration
        for i, site in enumerate(self._soles):
            mujoco.mj_jacSite(m, d, self._linear[i], self._angular[i], site)
            mujoco.mj_objectAcceleration(m, d, mujoco.mjtObj.mjOBJ_SITE, site, acceleration, 0)
            row = 12 + 6 * i
            drift[row : row + 3] = acceleration[3:]
            drift[row + 2] -= self.gravity  # MuJoCo accelerates the world upwards in gravity's place
            drift[row + 3 : row + 6] = acceleration[:3]
        self._site_position.take(self._site_places, 0, self.sole_position)
        self._site_matrix.take(self._site_places, 0, self.sole_rotation)
        np.dot(self.jacobian, self.velocity, self.task_velocity)

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

    def _centroidal(self) -> None:
        linear, linear_bias = self.mass_matrix[:3], self.bias[:3]
        np.multiply(linear, 1.0 / self.mass, out=self._com_rows)
        self.drift[COM] = linear_bias / self.mass
        self.drift[2] -= self.gravity
        x, y, z = self.com.tolist()
        cross = self._cross
        cross[0, 1], cross[0, 2], cross[1, 2] = -z, y, -x
        cross[1, 0], cross[2, 0], cross[2, 1] = z, -y, x
        np.dot(self.rotation, self.mass_matrix[3:6], self._momentum_rows)
        self._momentum_rows -= cross @ linear
        self.drift[MOMENTUM] = self.rotation @ self.bias[3:6] - cross @ linear_bias
