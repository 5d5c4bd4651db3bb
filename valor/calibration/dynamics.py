"""Identification of joint friction, and of mass and centre of mass of links, from joint torques.

While a joint j moves, its motor's torque is

    τ_j = model_j(q, q̇, q̈) + gravity_j(q)·δ + friction_j·sign(q̇_j) + damping_j·q̇_j + offset_j,

``model`` is the inverse dynamics of the nominal model without friction. ``gravity`` is the static torque of errors δ of
a link's mass, and of mass times centre of mass; their part in accelerations is neglected, since arms move slowly here.
All unknowns are estimated jointly by linear least squares with Huber weights. Torques do not determine all of δ: normal
priors with ``MASS_ERROR``, ``COM_ERROR`` and ``OFFSET`` keep the undetermined part nominal.
"""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import lsq_linear
from scipy.signal import savgol_filter

from valor.calibration.record import Record
from valor.common.arrays import FloatArray
from valor.robot.model import Model

MASS_ERROR = 0.2  # standard deviation of a link's mass, as a share of it
COM_ERROR = 0.03  # standard deviation of a link's CoM along each axis [m]
OFFSET = 1.0  # standard deviation of a joint's offset [N·m]
TORQUE_ERROR = 1.0  # standard deviation of a moment, which correlates with its neighbours [N·m]
MOST_MASS, MOST_COM = 0.7, 0.15  # largest error of a link's mass, as a share of it, and of its CoM [m]
MOVING = 0.06  # speed from which friction has one direction [rad/s]
HUBER = 1.5  # residual with full weight, at most, times the typical one
ROUNDS = 6
SMOOTHED = 11  # moments over which velocity is derived


@dataclass(frozen=True)
class Friction:
    """Friction of a joint, and the RMS torque errors that remain, as identified and of the nominal model [N·m]."""

    coulomb: float  # [N·m]
    viscous: float  # [N·m·s/rad]
    offset: float  # [N·m]
    residual: float
    nominal_residual: float


@dataclass(frozen=True)
class BodyInertia:
    """Mass [kg] and centre of mass (3,) in its frame [m] of a body."""

    mass: float
    com: FloatArray


def links(model: Model, joints: tuple[str, ...]) -> list[int]:
    """Body of each joint to which errors are attributed: the heaviest of those that it moves rigidly."""
    mj = model.mj
    chosen = []
    for name in joints:
        rigid = [int(mj.joint(name).bodyid[0])]
        rigid += [b for b in range(rigid[0] + 1, mj.nbody) if mj.body_parentid[b] in rigid and not mj.body_jntnum[b]]
        chosen.append(max(rigid, key=lambda body: float(mj.body_mass[body])))
    return chosen


class Regressor:
    """Nominal torques of an arm's m joints, and their derivatives by errors of its links."""

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
        """Set the orientation of the base (4,) and all joints (n,)."""
        self._data.qpos[:3], self._data.qpos[3:7] = 0.0, orientation
        self._data.qpos[self._qpos] = position

    def torque(self, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """(m,) torques of the nominal model [N·m]; the joints (m,) move, all others are at rest."""
        data = self._data
        data.qvel[:], data.qacc[:] = 0.0, 0.0
        data.qvel[self._dofs], data.qacc[self._dofs] = velocity, acceleration
        mujoco.mj_inverse(self._mj, data)
        torque: FloatArray = data.qfrc_inverse[self._dofs].copy()
        return torque

    def gravity(self) -> FloatArray:
        """(m, 4·m) derivatives by each link's mass, and by mass times CoM along x, y, z [N·m/kg, N·m/(kg·m)]."""
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
) -> tuple[dict[str, Friction], dict[str, BodyInertia]]:
    """Identify friction by joint, and masses and CoMs by body, of an arm.

    ``model``: nominal, with every joint; ``record``: at least ``SMOOTHED`` moments.
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
    friction = {}
    for j, name in enumerate(joints):
        coulomb, viscous, offset = found[4 * m + 3 * j : 4 * m + 3 * j + 3].tolist()
        left, nominal_left = (_rms((effort - by)[moving[:, j], j]) for by in (explained, nominal + velocity * known))
        friction[name] = Friction(coulomb, viscous, offset, left, nominal_left)
    made = {}
    for i, body in enumerate(bodies):
        mass = float(masses[i] + found[4 * i])
        com = model.mj.body_ipos[body] + found[4 * i + 1 : 4 * i + 4] / mass
        made[model.mj.body(body).name] = BodyInertia(mass, com)
    return friction, made


def _modelled(regressor: Regressor, record: Record, places: list[int]) -> tuple[FloatArray, FloatArray]:
    """Nominal torques (T, m), and their derivatives by errors of links (T, m, 4·m)."""
    velocity = record.velocity[:, places]
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
    """(k,) least squares within bounds; the weights (k,) draw each unknown to zero."""
    trust = np.ones(len(wanted))
    for _ in range(ROUNDS):
        trusted = columns * trust[:, None]
        # An equivalent problem with as many rows as unknowns.
        factor = np.linalg.cholesky(trusted.T @ columns + np.diag(weight * weight + 1e-9))
        found = lsq_linear(factor.T, np.linalg.solve(factor, trusted.T @ wanted), bounds).x
        off = np.abs(wanted - columns @ found)
        most = HUBER * max(1.4826 * float(np.median(off)), 1e-9)
        trust = np.minimum(1.0, most / np.maximum(off, 1e-12))
    return np.asarray(found)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values * values))) if values.size else 0.0
