"""The objective of the QP: what each task wants, weighed, as one quadratic in v̇.

A task i wants its acceleration Jᵢ·v̇ + dᵢ to be aᵢ. Posture tasks want accelerations of single joints. The sum

    ½·Σ wᵢ·‖Jᵢ·v̇ + dᵢ − aᵢ‖² + ½·Σ pⱼ·(v̇ⱼ − bⱼ)²  =  ½·v̇ᵀ·H·v̇ − gᵀ·v̇ + const.

has H = Σ wᵢ·JᵢᵀJᵢ + diag(p) and g = Σ wᵢ·Jᵢᵀ(aᵢ − dᵢ) + p∘b (Koolen et al. 2016, section 5; gains and weights: the
``whole_body`` table of robot.yaml). The weights are in different units: rows of angular momentum have entries of
10 kg·m², so that a weight of 0.003 there is already as much as 0.3 on an acceleration.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from motion_manager.whole_body.dynamics import (
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
from valor_common.robot import WholeBody

REGULARIZATION = 1e-4  # of every v̇ [1]: H is positive definite whatever the tasks


class Objective:
    """H and g of a control period.

    Attributes:
        acceleration: (24,) wanted; rows as in ``dynamics``. Written by the controller.
        posture: (nj,) wanted joint accelerations [rad/s²]. Written by the controller.
        hessian: (nv, nv). gradient: (nv,). Results of ``update``.
    """

    def __init__(self, table: WholeBody, joints: ModelJoints) -> None:
        weights = np.zeros(ROWS)
        weights[COM] = table.com_weight
        weights[MOMENTUM] = table.angular_momentum_weight
        weights[CHEST] = weights[PELVIS] = table.orientation_weight
        weights[SOLES] = table.foot_weight
        self._foot_root = sqrt(table.foot_weight)
        self._swinging: tuple[int | None, float] = (None, 0.0)
        self._root = np.sqrt(weights)
        self._root_column = self._root[:, None].copy()
        posture = np.zeros(joints.count)
        posture[joints.group("left_leg", "right_leg")] = table.leg_posture_weight
        posture[joints.group("torso")] = table.waist_posture_weight
        posture[joints.group("left_arm", "right_arm")] = table.arm_posture_weight
        self._posture_weight = posture
        nv = joints.count + 6
        diagonal = np.full(nv, REGULARIZATION)
        diagonal[6:] += posture
        self._diagonal = diagonal
        self.acceleration = np.zeros(ROWS)
        self.posture = np.zeros(joints.count)
        self.hessian = np.zeros((nv, nv))
        self.gradient = np.zeros(nv)
        self._hessian_diagonal = np.einsum("ii->i", self.hessian)
        self._joint_gradient = self.gradient[6:]
        self._weighted = np.zeros((ROWS, nv))
        self._wanted = np.zeros(ROWS)

    def swing(self, foot: int | None, weight: float) -> None:
        """The foot that swings from now on (0 left, 1 right; None: neither), and its task's weight."""
        if (foot, weight) == self._swinging:
            return
        self._swinging = (foot, weight)
        root = self._root
        root[SOLES] = self._foot_root
        if foot is not None:
            root[sole_rows(foot)] = sqrt(weight)
        self._root_column[:, 0] = root

    def update(self, dynamics: Dynamics) -> None:
        """Put the tasks together at this state."""
        weighted, wanted = self._weighted, self._wanted
        np.multiply(dynamics.jacobian, self._root_column, out=weighted)
        np.subtract(self.acceleration, dynamics.drift, out=wanted)
        wanted *= self._root
        np.dot(weighted.T, weighted, self.hessian)
        self._hessian_diagonal += self._diagonal
        np.dot(wanted, weighted, self.gradient)
        self._joint_gradient += self._posture_weight * self.posture
