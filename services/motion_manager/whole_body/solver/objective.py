"""The objective of the QP: what each task wants, weighed, as one quadratic in v̇.

A task i wants its acceleration Jᵢ·v̇ + dᵢ to be aᵢ. Posture tasks want accelerations of single joints. The sum

    ½·Σ wᵢ·‖Jᵢ·v̇ + dᵢ − aᵢ‖² + ½·Σ pⱼ·(v̇ⱼ − bⱼ)²  =  ½·v̇ᵀ·H·v̇ − gᵀ·v̇ + const.

has H = Σ wᵢ·JᵢᵀJᵢ + diag(p) and g = Σ wᵢ·Jᵢᵀ(aᵢ − dᵢ) + p∘b (Koolen et al. 2016, section 5; gains and weights: the
``whole_body`` table of robot.yaml). The weights are in different units: rows of angular momentum have entries of
10 kg·m², so that a weight of 0.003 there is already as much as 0.3 on an acceleration.
"""

from __future__ import annotations

from math import nan

import numpy as np

from valor.common.arrays import FloatArray
from valor.motion_manager.whole_body.model.dynamics import (
    CHEST,
    COM,
    MOMENTUM,
    PELVIS,
    ROWS,
    SOLES,
    Dynamics,
    ModelJoints,
    sole_rows,
)
from valor.motion_manager.whole_body.tasks.weights import TASKS
from valor.robot.motion_tables import WholeBody

REGULARIZATION = 1e-4  # of every v̇ [1]: H is positive definite whatever the tasks


class Objective:
    """H and g of a control period.

    Attributes:
        hessian: (nv, nv). gradient: (nv,). Results of ``update``.
    """

    def __init__(self, table: WholeBody, joints: ModelJoints) -> None:
        nv = joints.count + 6
        self._groups = (
            joints.group("left_arm", "right_arm"),
            joints.group("torso"),
            joints.group("left_leg", "right_leg"),
        )
        self._foot_weight = 0.0
        self._swinging: tuple[int | None, float] = (None, nan)
        self._weight_column = np.zeros((ROWS, 1))
        self._weight = self._weight_column[:, 0]  # of each row
        self._posture_weight = np.zeros(joints.count)
        self._diagonal = np.full(nv, REGULARIZATION)
        self.weigh(np.array([getattr(table, f"{task}_weight") for task in TASKS]))
        self.hessian = np.zeros((nv, nv))
        self.gradient = np.zeros(nv)
        self._hessian_diagonal = np.einsum("ii->i", self.hessian)
        self._joint_gradient = self.gradient[6:]
        self._weighted = np.zeros((ROWS, nv))
        self._wanted = np.zeros(ROWS)

    def weigh(self, weights: FloatArray) -> None:
        """Take (7,) weights in the order of ``TASKS``; ``swing`` is to be called after."""
        com, momentum, orientation, foot, *posture = weights.tolist()
        rows = self._weight
        rows[COM], rows[MOMENTUM] = com, momentum
        rows[CHEST] = rows[PELVIS] = orientation
        rows[SOLES] = self._foot_weight = foot
        for group, weight in zip(self._groups, posture, strict=True):
            self._posture_weight[group] = weight
        self._diagonal[6:] = REGULARIZATION + self._posture_weight
        self._swinging = (None, nan)  # equals nothing: the next ``swing`` is taken

    def swing(self, foot: int | None, weight: float) -> None:
        """The foot that swings from now on (0 left, 1 right; None: neither), and its task's weight."""
        if (foot, weight) == self._swinging:
            return
        self._swinging = (foot, weight)
        self._weight[SOLES] = self._foot_weight
        if foot is not None:
            self._weight[sole_rows(foot)] = weight

    def update(self, dynamics: Dynamics, acceleration: FloatArray, posture: FloatArray) -> None:
        """Put the tasks together at this state.

        Args:
            dynamics: at it.
            acceleration: (24,) wanted; rows as in ``dynamics``.
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
