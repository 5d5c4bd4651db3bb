"""Parts of the robot that must not touch one another, as limits of the QP.

Two shapes at a distance d approach no faster than proportionally to what is left of it above the distance kept:

    ḋ_min = −α·(d − d_kept),   d̈ ≥ β·(ḋ_min − ḋ)

a barrier of first order on velocity, as of the joints' stops (``joint_limits``; Ames et al. 2019; for distances:
Faverjon & Tournassoud 1987). With the nearest points p_a and p_b and their direction n = (p_b − p_a)/d,

    ḋ = nᵀ·(J_b − J_a)·v,   d̈ = nᵀ·(J_b − J_a)·v̇ + nᵀ·(J̇_b − J̇_a)·v

but for how n and the points travel, which the margin is for. Shapes and their distance are MuJoCo's.

A pair costs nothing while it is far: two parts at a distance d cannot be near before (d − d_near)/v_max, and are not
looked at until then.
"""

from __future__ import annotations

from heapq import heappop, heappush

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.model import Model
from valor.whole_body.constraints.limit import Limit
from valor.whole_body.model.dynamics import Dynamics

FASTEST = 4.0  # that two parts approach each other [m/s]
REACH = 0.6  # how far apart two parts are told from farther ones [m]
RETREAT = 0.3  # at which parts that are too near are driven apart, at most [m/s]
TOUCHING = 1e-6  # below which the nearest points have no direction of their own [m]


class SelfCollision:
    """Rows for the pairs that are near.

    Attributes:
        rows: how many there were at the last update.
        lower: (rows,) least d̈ of each [m/s²].
    """

    def __init__(self, model: Model) -> None:
        self._table = table = model.robot.tables.self_collision
        self._pairs = [(model.shape(one), model.shape(other)) for one, other in table.pairs]
        count, nv = len(self._pairs), model.mj.nv
        self._due = [(0, k) for k in range(count)]  # a heap: when each must be looked at again [ns]
        self._time = 0
        self._directions = np.zeros((count, 3))
        self._segment = np.zeros(6)
        self._one, self._other = np.zeros((3, nv)), np.zeros((3, nv))
        self._one_rate, self._other_rate = np.zeros((3, nv)), np.zeros((3, nv))
        self.rows = 0
        self.lower = np.zeros(0)

    def update(self, dynamics: Dynamics, velocity: FloatArray, time: int) -> Limit | None:
        """The limits at this state, or None.

        Args:
            dynamics: at this state.
            velocity: (nj,) of the joints, as the QP's accelerations change it [rad/s].
            time: robot time [ns].
        """
        self.rows = 0
        if time < self._time:  # another world
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

    def _row(self, dynamics: Dynamics, k: int, distance: float) -> tuple[FloatArray, float]:
        """(nv,) nᵀ·(J_b − J_a), and nᵀ·(J̇_b − J̇_a)·v, of a pair."""
        (one, other), segment, direction = self._pairs[k], self._segment, self._directions[k]
        if abs(distance) > TOUCHING:  # else that of the last time
            np.subtract(segment[3:], segment[:3], out=direction)
            direction /= np.copysign(np.linalg.norm(direction), distance)
        dynamics.point_jacobian(one, segment[:3], self._one, self._one_rate)
        dynamics.point_jacobian(other, segment[3:], self._other, self._other_rate)
        self._other -= self._one
        self._other_rate -= self._one_rate
        return direction @ self._other, float(direction @ (self._other_rate @ dynamics.velocity))
