"""The centre of mass, as balance needs it.

    c̈ = ω²·(c − v)

with v the virtual repellent point that the law of the DCM asks for (``balance.dcm``). Weight: ``com_weight``.
"""

from __future__ import annotations

from valor.common.kernel import Expression
from valor.robot.model import Model
from valor.whole_body.model.motion import CentreOfMassMotion, Motion
from valor.whole_body.tasks.task import Period, Task


class CentreOfMass(Task):
    """The CoM's acceleration [m/s²]."""

    name = weight = "com"

    @staticmethod
    def motion(model: Model) -> Motion:
        """Of the CoM."""
        return CentreOfMassMotion()

    def acceleration(self, period: Period, velocity: Expression, pose: Expression) -> Expression:
        """(3,) c̈, no more than the soles' grip gives."""
        return period.law.acceleration(period.com, period.repellent_point)
