"""The joints' posture: arms and waist as commanded, legs nominal or as the pelvis is led.

    q̈ = q̈_ref + k_d·(q̇_ref + clip(k_p/k_d·(q_ref − q)) − q̇)

clipped to a share of the joint's velocity limit. It wants accelerations of single joints, each with the weight of its
group: ``arm_posture_weight``, ``waist_posture_weight``, ``leg_posture_weight``. k_p: ``posture_stiffness``, k_d:
``posture_damping``.
"""

from __future__ import annotations

import casadi as ca

from valor.common.kernel import Expression, clipped
from valor.robot.description import RobotDescription
from valor.robot.model import Indices
from valor.whole_body.tuning_tables import Tuning

CATCH_UP = 0.5  # of its velocity limit, at which a joint's set-point makes up for a distant reference at most
GROUPS = {
    "arm_posture": ("left_arm", "right_arm"),
    "waist_posture": ("torso",),
    "leg_posture": ("left_leg", "right_leg"),
}
"""Weight → the groups of joints that have it."""


class Posture:
    """q̈ [rad/s²]."""

    def __init__(self, robot: RobotDescription, places: Indices, legs: list[int]) -> None:
        """Of the model's joints.

        Args:
            robot: its tables.
            places: of the model's joints among the robot's.
            legs: which of the model's joints are the legs'.
        """
        self._table, self._legs = robot.read(Tuning).whole_body, legs
        self._catch_up = ca.DM(CATCH_UP * robot.velocity_limit[places])

    def acceleration(
        self, asked: Expression, legs: Expression, position: Expression, velocity: Expression
    ) -> Expression:
        """(nj,) q̈.

        Args:
            asked: (3, nj) position, velocity and acceleration that are commanded; those of the legs unread.
            legs: (m,) positions of the legs' joints, which shall be at rest [rad].
            position: (nj,) [rad].
            velocity: (nj,) [rad/s].
        """
        stiffness, damping = self._table.posture_stiffness, self._table.posture_damping
        places, rate, acceleration = (ca.SX(asked[i, :].T) for i in range(3))
        places[self._legs], rate[self._legs], acceleration[self._legs] = legs, 0.0, 0.0
        catch_up = clipped(stiffness / damping * (places - position), -self._catch_up, self._catch_up)
        return acceleration + damping * (rate + catch_up - velocity)
