"""The objective of the QP: what each task wants, weighed, as one quadratic in v̇.

A task i wants its acceleration Jᵢ·v̇ + dᵢ to be aᵢ. The posture wants accelerations of single joints. The sum

    ½·Σ wᵢ·‖Jᵢ·v̇ + dᵢ − aᵢ‖² + ½·Σ pⱼ·(v̇ⱼ − bⱼ)²  =  ½·v̇ᵀ·H·v̇ − gᵀ·v̇ + const.

has H = Σ wᵢ·JᵢᵀJᵢ + diag(p) and g = Σ wᵢ·Jᵢᵀ(aᵢ − dᵢ) + p∘b (Koolen et al. 2016, section 5). The weights are in
different units, as the tasks are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from valor.common.arrays import FloatArray
from valor.whole_body.model.dynamics import Dynamics, ModelJoints
from valor.whole_body.model.motion import Motions
from valor.whole_body.tasks.posture import GROUPS
from valor.whole_body.tasks.task import Task

REGULARIZATION = 1e-4  # of every v̇ [1]: H is positive definite whatever the tasks


class Objective:
    """H and g of a control period.

    Attributes:
        hessian: (nv, nv). gradient: (nv,). Results of ``update``.
    """

    def __init__(self, tasks: Sequence[Task], motions: Motions, joints: ModelJoints) -> None:
        """Of these tasks and their motions; ``weigh`` is to be called before ``update``."""
        nv, rows = joints.count + 6, motions.count
        self._tasks = [(task, motions.rows[task.name]) for task in tasks]
        self._groups = {weight: joints.group(*groups) for weight, groups in GROUPS.items()}
        self._weight_column = np.zeros((rows, 1))
        self._weight = self._weight_column[:, 0]  # of each row
        self._posture_weight = np.zeros(joints.count)
        self._diagonal = np.full(nv, REGULARIZATION)
        self.hessian = np.zeros((nv, nv))
        self.gradient = np.zeros(nv)
        self._hessian_diagonal = np.einsum("ii->i", self.hessian)
        self._joint_gradient = self.gradient[6:]
        self._weighted = np.zeros((rows, nv))
        self._wanted = np.zeros(rows)

    def weigh(self, weights: Mapping[str, float], swinging: int | None) -> None:
        """Take weights by their names, and the foot that swings (0 left, 1 right; None: neither)."""
        for task, rows in self._tasks:
            task.weigh(weights[task.weight], swinging, self._weight[rows])
        for weight, group in self._groups.items():
            self._posture_weight[group] = weights[weight]
        self._diagonal[6:] = REGULARIZATION + self._posture_weight

    def update(self, dynamics: Dynamics, acceleration: FloatArray, posture: FloatArray) -> None:
        """Put the tasks together at this state.

        Args:
            dynamics: at it.
            acceleration: (rows,) wanted of the tasks' motions.
            posture: (nj,) wanted of the joints [rad/s²].
        """
        weighted, wanted = self._weighted, self._wanted
        np.multiply(dynamics.jacobian, self._weight_column, out=weighted)
        np.subtract(acceleration, dynamics.drift, out=wanted)
        # Two matrices: of one with itself NumPy makes a triangle, and copies it number by number.
        np.dot(dynamics.jacobian.T, weighted, self.hessian)
        self._hessian_diagonal += self._diagonal
        np.dot(wanted, weighted, self.gradient)
        self._joint_gradient += self._posture_weight * posture
