"""Constraints of the QP: limits of joints, contact forces of the feet, and distances of bodies.

Limits bound quantities y = c·v̇ + e − s·ρ of accelerations v̇ and contact forces ρ.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from heapq import heappop, heappush
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel, clipped
from valor.control.tuning_tables import Tuning, WholeBody
from valor.robot.description import RobotDescription
from valor.robot.model import Indices, Model
from valor.robot.tables import Foot
from valor.whole_body.task_dynamics import TaskDynamics

FASTEST = 4.0  # Highest speed at which two bodies approach each other [m/s]
REACH = 0.6  # Largest distance computed [m]
RETREAT = 0.3  # Highest speed at which bodies that are too near separate [m/s]
TOUCHING = 1e-6  # Distance below which the nearest points give no direction [m]
POINTS = 4
EDGES = 4
GENERATORS = POINTS * EDGES  # per foot
UNBOUNDED = 1e30  # to the solver


class Limit(NamedTuple):
    """Rows of limited quantities y = c·v̇ + e − s·ρ."""

    rows: FloatArray  # (k, nv) c
    offset: FloatArray  # (k,) e
    forces: FloatArray  # (k, nρ) s


class Solved(NamedTuple):
    """Solution without these limits: terms of the model's joints, as expressions."""

    inertial: Expression  # (nj,) M·v̇ [N·m]
    bias: Expression  # (nj,) h [N·m]
    contact: Expression  # (nj,) torque of the contact forces [N·m]
    velocity: Expression  # (nj,) q̇ [rad/s]
    acceleration: Expression  # (nj,) q̈ [rad/s²]


class JointLimit(ABC):
    """Limit of every joint; a row joins the problem if the solution without it exceeds its bounds."""

    @abstractmethod
    def value(self, solved: Solved) -> Expression:
        """Return (nj,) y."""

    @abstractmethod
    def rows(self, dynamics: TaskDynamics, forces: FloatArray, joints: npt.NDArray[np.intp]) -> Limit:
        """Return the limits of (k,) joints of the model; ``forces`` is (nρ, nv), generalised forces of generators."""


class JointLimits(JointLimit):
    """q̈ [rad/s²] of the model's joints, and its bounds.

    The speed of a joint towards its stop is at most proportional to the remaining distance:

        v_max(q) = min(velocity limit, α·(q_upper − q)),   q̈ ≤ β·(v_max(q) − q̇)

    and alike for the lower limit: a first-order barrier on velocity (Ames et al. 2019 on control barrier functions).
    With q_lower ≤ q_upper the bounds never cross.
    """

    def __init__(self, robot: RobotDescription, table: WholeBody, places: Indices) -> None:
        self._approach = table.limit_approach
        self._response = table.limit_response
        self._velocity = ca.DM(robot.velocity_limit[places])
        self._lower, self._upper = ca.DM(robot.lower[places]), ca.DM(robot.upper[places])

    def acceleration(self, position: Expression, velocity: Expression) -> tuple[Expression, Expression]:
        """Return (nj,) lower and upper bounds of acceleration [rad/s²] at (nj,) ``position`` and ``velocity``."""
        most = self._velocity
        lower, upper = (
            self._response * (clipped(self._approach * (end - position), -most, most) - velocity)
            for end in (self._lower, self._upper)
        )
        return lower, upper

    def value(self, solved: Solved) -> Expression:
        return solved.acceleration

    def rows(self, dynamics: TaskDynamics, forces: FloatArray, joints: npt.NDArray[np.intp]) -> Limit:
        rows = np.zeros((joints.size, dynamics.velocity.size))
        rows[np.arange(joints.size), 6 + joints] = 1.0
        return Limit(rows, np.zeros(joints.size), np.zeros((joints.size, forces.shape[0])))


class TorqueLimits(JointLimit):
    """Torques within the effort limits [N·m].

        τ = M_j·v̇ + h_j + D·q̇ − (Wᵀ·ρ)_j,   |τ| ≤ τ_max

    with j the joints' rows of the equations of motion, (nj,) D their viscous damping and Wᵀ·ρ the contact forces.
    """

    def __init__(self, damping: FloatArray) -> None:
        self._damping = damping

    def value(self, solved: Solved) -> Expression:
        return solved.inertial + solved.bias + ca.DM(self._damping) * solved.velocity - solved.contact

    def rows(self, dynamics: TaskDynamics, forces: FloatArray, joints: npt.NDArray[np.intp]) -> Limit:
        offset = dynamics.bias[6:] + self._damping * dynamics.joint_velocity
        return Limit(dynamics.mass_matrix[6 + joints], offset[joints], forces[:, 6 + joints].T)


def contact_points(foot: Foot, inset: float) -> FloatArray:
    """Return (4, 3) contact points in the sole's frame [m], ``inset`` [m] inside the edges."""
    x = (foot.heel + inset, foot.toe - inset)
    y = (foot.half_width - inset, -foot.half_width + inset)
    return np.array([(px, py, 0.0) for px in x for py in y])


def sole_generators(points: FloatArray, friction: float) -> FloatArray:
    """Return (6, 16) wrenches at the sole's origin of unit vertical force along edges within the ``friction`` cone."""
    t = friction / np.sqrt(2.0)
    edges = np.array([(t, t, 1.0), (t, -t, 1.0), (-t, t, 1.0), (-t, -t, 1.0)])
    wrenches = [np.concatenate((edge, np.cross(point, edge))) for point in points for edge in edges]
    return np.array(wrenches).T


class FootContacts:
    """Contact forces of both feet, as non-negative sums ρ of generators.

    Each sole has four contact points, each point a friction pyramid with four edges. The centre of pressure of such
    forces lies within the rectangle of the points: ρ ≥ 0 implies CoP limit, unilaterality and friction (Koolen et al.
    2016, section 4.2).
    """

    def __init__(self, robot: RobotDescription, nv: int) -> None:
        feet, table = robot.tables.feet, robot.read(Tuning).whole_body
        self.points = np.array([contact_points(foot, table.contact_inset) for foot in (feet.left, feet.right)])
        self.count = 2 * GENERATORS  # 32 generators, 16 of the left foot first
        self.forces = np.zeros((self.count, nv))  # (32, nv) generalised force of each generator: wrenchᵀ·J
        self._in_sole = np.array([sole_generators(points, table.friction).T for points in self.points])
        self._in_odom = np.zeros((2, GENERATORS, 6))
        self._vertical = self._in_odom[:, :, 2]
        self._left, self._right = self.forces[:GENERATORS], self.forces[GENERATORS:]
        self._rotation = np.zeros((2, 3, 3))
        self._turn = Kernel("generators", self._expressions, (self._rotation,), (self._in_odom,))

    def upper(self, load: Sequence[float], weight: float) -> FloatArray:
        """Return (32,) upper bounds for a weight [N]; ``load`` of each foot is from 0 (none) to 1 (unlimited)."""
        return np.repeat([share * (weight / POINTS) if share < 1.0 else UNBOUNDED for share in load], GENERATORS)

    def update(self, sole_jacobian: FloatArray, sole_rotation: FloatArray) -> None:
        """Rotate the generators with (2, 3, 3) the soles; ``sole_jacobian`` (12, nv) as of ``SoleMotions``, in odom."""
        self._rotation[:] = sole_rotation
        self._turn()
        np.dot(self._in_odom[0], sole_jacobian[:6], self._left)
        np.dot(self._in_odom[1], sole_jacobian[6:], self._right)

    def _expressions(self, rotations: Expression) -> Sequence[Expression]:
        """(32, 6) generators of both feet in odom."""
        turned = []
        for foot, rotation in enumerate(ca.vertsplit(rotations, 3)):
            generators = ca.DM(self._in_sole[foot])
            turned.append(ca.horzcat(generators[:, :3] @ rotation.T, generators[:, 3:] @ rotation.T))
        return [ca.vertcat(*turned)]

    def vertical_forces(self, rho: FloatArray) -> FloatArray:
        """Return (2,) vertical force of each foot [N]."""
        forces: FloatArray = np.vecdot(self._vertical, rho.reshape(2, GENERATORS))
        return forces


class SelfCollision:
    """Limits that keep bodies of the robot apart.

    Two shapes at a distance d approach each other at most in proportion to the rest above the distance kept:

        ḋ_min = −α·(d − d_kept),   d̈ ≥ β·(ḋ_min − ḋ)

    a first-order barrier on velocity, as for the joints' stops (for distances: Faverjon & Tournassoud 1987). With the
    nearest points p_a and p_b and their direction n = (p_b − p_a)/d,

        ḋ = nᵀ·(J_b − J_a)·v,   d̈ = nᵀ·(J_b − J_a)·v̇ + nᵀ·(J̇_b − J̇_a)·v

    without the motion of n and of the points, which the margin covers. Shapes and their distance are MuJoCo's. A
    distant pair costs nothing: at a distance d it cannot be near before (d − d_near)/v_max, and is not checked until
    then.
    """

    def __init__(self, model: Model) -> None:
        self._table = table = model.robot.tables.self_collision
        self._pairs = [(model.shape(one), model.shape(other)) for one, other in table.pairs]
        count, nv = len(self._pairs), model.mj.nv
        self._due = [(0, k) for k in range(count)]  # heap: robot time of the next check of each pair [ns]
        self._time = 0
        self._directions = np.zeros((count, 3))
        self._segment = np.zeros(6)
        self._one, self._other = np.zeros((3, nv)), np.zeros((3, nv))
        self._one_rate, self._other_rate = np.zeros((3, nv)), np.zeros((3, nv))
        self.rows = 0  # number of limits at the last update
        self.lower = np.zeros(0)  # (rows,) lower bounds of d̈ [m/s²]

    def update(self, dynamics: TaskDynamics, velocity: FloatArray, time: int) -> Limit | None:
        """Return the limits at this state and time [ns], or None; ``velocity`` (nj,) is changed by the QP [rad/s]."""
        self.rows = 0
        if time < self._time:  # simulation restarted
            self._due = [(0, k) for k in range(len(self._pairs))]
        self._time = time
        due = self._due
        if not due or due[0][0] > time:
            return None
        table, rows, offsets, lower = self._table, [], [], []
        looked: list[tuple[int, int]] = []
        while due and due[0][0] <= time:
            _, k = heappop(due)
            distance = dynamics.nearest(*self._pairs[k], REACH, self._segment)
            if distance >= table.near:
                looked.append((time + int(1e9 * (distance - table.near) / FASTEST), k))
                continue
            looked.append((time, k))
            row, offset = self._row(dynamics, k, distance)
            allowed = min(RETREAT, -table.approach * (distance - table.distance))
            rows.append(row)
            offsets.append(offset)
            lower.append(table.response * (allowed - float(row[6:] @ velocity)))
        for pair in looked:
            heappush(due, pair)
        if not rows:
            return None
        self.rows, self.lower = len(rows), np.array(lower)
        return Limit(np.array(rows), np.array(offsets), np.zeros((len(rows), 0)))

    def _row(self, dynamics: TaskDynamics, k: int, distance: float) -> tuple[FloatArray, float]:
        """(nv,) nᵀ·(J_b − J_a), and nᵀ·(J̇_b − J̇_a)·v, of pair k."""
        (one, other), segment, direction = self._pairs[k], self._segment, self._directions[k]
        if abs(distance) > TOUCHING:  # else the last direction
            np.subtract(segment[3:], segment[:3], out=direction)
            direction /= np.copysign(np.linalg.norm(direction), distance)
        dynamics.point_jacobian(one, segment[:3], self._one, self._one_rate)
        dynamics.point_jacobian(other, segment[3:], self._other, self._other_rate)
        self._other -= self._one
        self._other_rate -= self._one_rate
        return direction @ self._other, float(direction @ (self._other_rate @ dynamics.velocity))
