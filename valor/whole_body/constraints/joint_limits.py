"""What the joints can do: bounds on acceleration from the limits of position and velocity."""

from __future__ import annotations

import casadi as ca
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, clipped
from valor.robot.description import RobotDescription
from valor.robot.model import Indices
from valor.whole_body.constraints.limit import JointLimit, Limit, Solved
from valor.whole_body.model.dynamics import Dynamics
from valor.whole_body.tuning_tables import WholeBody


class JointLimits(JointLimit):
    """q̈ [rad/s²] of the model's joints, and its bounds.

    A joint may approach its stop no faster than proportionally to what is left, and is kept from going faster:

        v_max(q) = min(velocity limit, α·(q_upper − q)),   q̈ ≤ β·(v_max(q) − q̇)

    and alike below: a barrier of first order on velocity (Ames et al. 2019 on control barrier functions). With
    q_lower ≤ q_upper the bounds never cross, wherever the joint is.
    """

    def __init__(self, robot: RobotDescription, table: WholeBody, places: Indices) -> None:
        self._approach = table.limit_approach
        self._response = table.limit_response
        self._velocity = ca.DM(robot.velocity_limit[places])
        self._lower, self._upper = ca.DM(robot.lower[places]), ca.DM(robot.upper[places])

    def acceleration(self, position: Expression, velocity: Expression) -> tuple[Expression, Expression]:
        """(nj,) lower and upper bounds of joint accelerations [rad/s²] at (nj,) ``position`` and ``velocity``."""
        most = self._velocity
        lower, upper = (
            self._response * (clipped(self._approach * (end - position), -most, most) - velocity)
            for end in (self._lower, self._upper)
        )
        return lower, upper

    def value(self, solved: Solved) -> Expression:
        """(nj,) q̈."""
        return solved.acceleration

    def rows(self, dynamics: Dynamics, forces: FloatArray, joints: npt.NDArray[np.intp]) -> Limit:
        """Of some joints."""
        rows = np.zeros((joints.size, dynamics.velocity.size))
        rows[np.arange(joints.size), 6 + joints] = 1.0
        return Limit(rows, np.zeros(joints.size), np.zeros((joints.size, forces.shape[0])))
