"""Chest and pelvis turned as the reference has them.

    ω̇ = k_p·e + k_d·(ω_ref − ω)

with e = sin(θ)·axis of the rotation from the actual to the desired one (``rotation.error``). Weight of both:
``orientation_weight``; k_p: ``orientation_stiffness``, k_d: ``orientation_damping``.
"""

from __future__ import annotations

from abc import abstractmethod

import casadi as ca

from valor.common import rotation
from valor.common.kernel import Expression, by_rows
from valor.robot.model import Model
from valor.whole_body.balance.reference import Reference
from valor.whole_body.model.motion import BodyTurn, Motion, PelvisTurn
from valor.whole_body.tasks.task import Period, Task
from valor.whole_body.tuning_tables import Tuning


class _Orientation(Task):
    """ω̇ [rad/s²]."""

    weight = "orientation"

    @staticmethod
    @abstractmethod
    def desired(reference: Reference) -> Expression:
        """(3, 3)."""

    def acceleration(self, period: Period, velocity: Expression, pose: Expression) -> Expression:
        """(3,) ω̇."""
        table, reference = self.robot.read(Tuning).whole_body, period.reference
        wanted = table.orientation_stiffness * ca.vertcat(*rotation.error(self.desired(reference), by_rows(pose)))
        return wanted + table.orientation_damping * (reference.turning - velocity)


class ChestOrientation(_Orientation):
    """Of the chest."""

    name = "chest"

    @staticmethod
    def motion(model: Model) -> Motion:
        """Of the chest."""
        return BodyTurn(model, model.robot.tables.chest)

    @staticmethod
    def desired(reference: Reference) -> Expression:
        """(3, 3)."""
        return reference.chest


class PelvisOrientation(_Orientation):
    """Of the pelvis."""

    name = "pelvis"

    @staticmethod
    def motion(model: Model) -> Motion:
        """Of the pelvis."""
        return PelvisTurn()

    @staticmethod
    def desired(reference: Reference) -> Expression:
        """(3, 3)."""
        return reference.pelvis
