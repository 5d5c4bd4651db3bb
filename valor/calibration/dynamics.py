"""Friction of an arm's joints, masses and centres of mass of its links, found of the torques that move it.

While a joint j moves, its motor's torque is

    τ_j = model_j(q, q̇, q̈) + gravity_j(q)·δ + friction_j·sign(q̇_j) + damping_j·q̇_j + offset_j,

``model`` being inverse dynamics of the nominal model without friction, and ``gravity`` what a link's error δ of mass,
and of mass times centre of mass, adds to it at rest (its part in accelerations is left out: arms move slowly here).
All is linear, and found together by least squares that believe an outlier less (Huber). Not all of δ can be told
apart by torques alone; what they say nothing of stays nominal, for errors are taken to be normal, as ``MASS_ERROR``,
``COM_ERROR`` and ``OFFSET`` have them.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.optimize import lsq_linear
from scipy.signal import savgol_filter

from valor.calibration.record import Record
from valor.common.arrays import FloatArray
from valor.robot.model import Model

MASS_ERROR = 0.2  # standard deviation, share of a link's mass
COM_ERROR = 0.03  # likewise, along each axis [m]
OFFSET = 1.0  # likewise [N·m]
TORQUE_ERROR = 1.0  # of one moment, which errs as those around it [N·m]
MOST_MASS, MOST_COM = 0.7, 0.15  # most that a link's mass is off, as a share; its CoM [m]
MOVING = 0.06  # from which on friction acts one way [rad/s]
HUBER = 1.5  # residual that is believed less, times the typical one
ROUNDS = 6
SMOOTHED = 11  # moments over which velocity is derived


@dataclass(frozen=True)
class Friction:
    """A joint: Coulomb [N·m], viscous [N·m·s/rad], offset [N·m]; RMS of what is left, and by nominal numbers [N·m]."""

    coulomb: float
    viscous: float
    offset: float
    residual: float
    nominal_residual: float


@dataclass(frozen=True)
class Link:
    """A body: mass [kg] and centre of mass (3,) in its frame [m]."""

    mass: float
    com: FloatArray


@dataclass(frozen=True)
class Torques:
    """Of the arm's m joints at T moments (T, m) [N·m]: measured, by nominal numbers, as found.

    Beside them the joints' velocities [rad/s], and where these are enough to be gone by.
    """

    velocity: FloatArray
    measured: FloatArray
    nominal: FloatArray
    found: FloatArray
    moving: npt.NDArray[np.bool_]


def links(model: Model, joints: tuple[str, ...]) -> list[int]:
    """Of each joint the body that its errors are ascribed to: of those that it turns as one, the heaviest."""
    mj = model.mj
    chosen = []
    for name in joints:
        rigid = [int(mj.joint(name).bodyid[0])]
        rigid += [b for b in range(rigid[0] + 1, mj.nbody) if mj.body_parentid[b] in rigid and not mj.body_jntnum[b]]
        chosen.append(max(rigid, key=lambda body: float(mj.body_mass[body])))
    return chosen


class Regressor:
    """The nominal model's torques of an arm's m joints, and what errors of its links add to them."""

    def __init__(self, model: Model, joints: tuple[str, ...]) -> None:
        self._mj = mj = copy.copy(model.mj)
        self._qpos = np.arange(mj.nq)[model.qpos]
        self._dofs = np.array([int(mj.joint(name).dofadr[0]) for name in joints])
        mj.dof_damping[self._dofs] = 0.0
        mj.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        self._data = mujoco.MjData(mj)
        self.bodies = links(model, joints)
        self._gravity = float(np.linalg.norm(mj.opt.gravity))

    def place(self, orientation: FloatArray, position: FloatArray) -> None:
        """Bring the base (4,) and all joints (n,) there."""
        self._data.qpos[:3], self._data.qpos[3:7] = 0.0, orientation
        self._data.qpos[self._qpos] = position

    def torque(self, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """(m,) by the nominal model, the arm (m,) moving so and all else at rest [N·m]."""
        data = self._data
        data.qvel[:], data.qacc[:] = 0.0, 0.0
        data.qvel[self._dofs], data.qacc[self._dofs] = velocity, acceleration
        mujoco.mj_inverse(self._mj, data)
        torque: FloatArray = data.qfrc_inverse[self._dofs].copy()
        return torque

    def gravity(self) -> FloatArray:
        """(m, 4·m) what a kilogram more of each link adds, and a kilogram times its CoM's shift along x, y, z [N·m]."""
        mj, data, dofs = self._mj, self._data, self._dofs
        mujoco.mj_kinematics(mj, data)
        mujoco.mj_comPos(mj, data)
        along, about = np.zeros((3, mj.nv)), np.zeros((3, mj.nv))
        columns = np.empty((len(dofs), 4 * len(self.bodies)))
        for i, body in enumerate(self.bodies):
            mujoco.mj_jac(mj, data, along, about, data.xipos[body], body)
            turn = data.xmat[body].reshape(3, 3)
            columns[:, 4 * i] = along[2, dofs]
            columns[:, 4 * i + 1 : 4 * i + 4] = np.outer(about[0, dofs], turn[1]) - np.outer(about[1, dofs], turn[0])
        return self._gravity * columns


def identify(
    model: Model, joints: tuple[str, ...], record: Record
) -> tuple[dict[str, Friction], dict[str, Link], Torques]:
    """Find friction of an arm's joints and errors of its links.

    Args:
        model: nominal, every joint in it.
        joints: of the arm, m of them.
        record: of its motions; at least ``SMOOTHED`` moments.

    Returns:
        By joint, by body, and the torques that they explain.
    """
    places, m = [model.robot.index[name] for name in joints], len(joints)
    velocity, effort = record.velocity[:, places], record.effort[:, places]
    regressor = Regressor(model, joints)
    nominal, gravity = _modelled(regressor, record, places)
    bodies = regressor.bodies
    masses = model.mj.body_mass[bodies]
    scale = np.column_stack((MASS_ERROR * masses, *[COM_ERROR * masses] * 3)).reshape(-1)
    bound = np.column_stack((MOST_MASS * masses, *[MOST_COM * masses] * 3)).reshape(-1)
    moving = np.abs(velocity) > MOVING
    columns = np.zeros((*effort.shape, 7 * m))
    columns[:, :, : 4 * m] = gravity
    for j in range(m):
        columns[:, j, 4 * m + 3 * j : 4 * m + 3 * j + 3] = np.column_stack(
            (np.sign(velocity[:, j]), velocity[:, j], np.ones(len(velocity)))
        )
    high = np.concatenate((bound, np.tile((np.inf, np.inf, 10.0 * OFFSET), m)))
    low = np.concatenate((-bound, np.tile((0.0, 0.0, -10.0 * OFFSET), m)))
    weight = np.concatenate((TORQUE_ERROR / scale, np.tile((0.0, 1e-6, TORQUE_ERROR / OFFSET), m)))
    found = _solve(columns[moving], (effort - nominal)[moving], weight, (low, high))

    explained = nominal + columns @ found
    known = [model.robot.tables.joints[name].damping for name in joints]
    torques = Torques(velocity, effort, nominal + velocity * known, explained, moving)
    friction = {}
    for j, name in enumerate(joints):
        coulomb, viscous, offset = found[4 * m + 3 * j : 4 * m + 3 * j + 3].tolist()
        left, nominal_left = (_rms((effort - by)[moving[:, j], j]) for by in (explained, torques.nominal))
        friction[name] = Friction(coulomb, viscous, offset, left, nominal_left)
    made = {}
    for i, body in enumerate(bodies):
        mass = float(masses[i] + found[4 * i])
        com = model.mj.body_ipos[body] + found[4 * i + 1 : 4 * i + 4] / mass
        made[model.mj.body(body).name] = Link(mass, com)
    return friction, made, torques


def _modelled(regressor: Regressor, record: Record, places: list[int]) -> tuple[FloatArray, FloatArray]:
    """(T, m) the nominal model's torques; (T, m, 4·m) what errors add."""
    velocity = record.velocity[:, places]
    # Joints' encoders are better than their velocities; both are derived over the same moments.
    step = float(np.median(np.diff(record.time)))
    acceleration = savgol_filter(velocity, SMOOTHED, 2, deriv=1, delta=step, axis=0)
    smooth = savgol_filter(velocity, SMOOTHED, 2, axis=0)
    torques, columns = [], []
    for t in range(len(record.time)):
        regressor.place(record.orientation[t], record.position[t])
        torques.append(regressor.torque(smooth[t], acceleration[t]))
        columns.append(regressor.gravity())
    return np.array(torques), np.array(columns)


def _solve(
    columns: FloatArray, wanted: FloatArray, weight: FloatArray, bounds: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """(k,) least squares within bounds, each unknown held to zero by its weight (k,)."""
    trust = np.ones(len(wanted))
    for _ in range(ROUNDS):
        trusted = columns * trust[:, None]
        # The same in as many rows as there are unknowns.
        factor = np.linalg.cholesky(trusted.T @ columns + np.diag(weight * weight + 1e-9))
        found = lsq_linear(factor.T, np.linalg.solve(factor, trusted.T @ wanted), bounds).x
        off = np.abs(wanted - columns @ found)
        most = HUBER * max(1.4826 * float(np.median(off)), 1e-9)
        trust = np.minimum(1.0, most / np.maximum(off, 1e-12))
    solution: FloatArray = found
    return solution


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values * values))) if values.size else 0.0
