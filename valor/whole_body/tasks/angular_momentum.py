"""Angular momentum about the centre of mass, damped.

    k̇ = −k_d·k

Weight: ``angular_momentum_weight``; k_d: ``angular_momentum_gain``. Its rows have entries of 10 kg·m², so that a
weight of 0.003 is already as much as 0.3 on an acceleration.
"""

from __future__ import annotations

from valor.common.kernel import Expression
from valor.robot.model import Model
from valor.whole_body.model.motion import MomentumMotion, Motion
from valor.whole_body.tasks.task import Period, Task
from valor.whole_body.tuning_tables import Tuning


class AngularMomentum(Task):
    """k̇ [N·m]."""

    name = weight = "angular_momentum"

    @staticmethod
    def motion(model: Model) -> Motion:
        """Of all bodies about the CoM."""
        return MomentumMotion()

    def acceleration(self, period: Period, velocity: Expression, pose: Expression) -> Expression:
        """(3,) k̇."""
        return -self.robot.read(Tuning).whole_body.angular_momentum_gain * velocity
