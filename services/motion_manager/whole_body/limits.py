"""What the joints can do: bounds on torque, and on acceleration from the limits of position and velocity."""

from __future__ import annotations

import numpy as np

from motion_manager.whole_body.state import FloatArray
from valor_common.model import Indices
from valor_common.robot import RobotDescription, WholeBody


class JointLimits:
    """Bounds of the model's joints.

    A joint may approach its stop no faster than proportionally to what is left, and is kept from going faster:

        v_max(q) = min(velocity limit, α·(q_upper − q)),   q̈ ≤ β·(v_max(q) − q̇)

    and alike below: a barrier of first order on velocity (Ames et al. 2019 on control barrier functions). With
    q_lower ≤ q_upper the bounds never cross, wherever the joint is.

    Attributes:
        effort: (nj,) limits [N·m].
    """

    def __init__(self, robot: RobotDescription, table: WholeBody, places: Indices) -> None:
        self.effort: FloatArray = robot.effort_limit[places]
        self._approach = table.limit_approach
        self._response = table.limit_response
        self._velocity: FloatArray = robot.velocity_limit[places]
        self._ends = np.stack((robot.lower[places], robot.upper[places]))
        self._minus_velocity = -self._velocity

    def acceleration(self, position: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(nj,) lower and upper bounds of joint accelerations [rad/s²] at ``position`` and ``velocity``."""
        bounds = self._ends - position
        bounds *= self._approach
        np.minimum(bounds, self._velocity, out=bounds)
        np.maximum(bounds, self._minus_velocity, out=bounds)
        bounds -= velocity
        bounds *= self._response
        return bounds[0], bounds[1]
