"""The feet: a standing one stays, both keep their stance to each other, a swinging one follows its path.

    standing   a = −k_d·v + hold
    swinging   a = a_ref + k_p·(x_ref − x) + k_d·(v_ref − v)

Weight: ``foot_weight``, of the swinging one that of the ``walking`` table. Gains: ``foot_damping`` and
``stance_stiffness``; swinging, ``foot_stiffness`` and ``foot_damping`` of the ``walking`` table.

The stance is held against creep. What the model has wrong makes the legs push the feet apart, and however little they
creep, over an hour it is a split. The ground tells nothing about it, but the encoders do: each foot is drawn back by
half of what they have moved apart or turned towards each other. Where both feet are together is no business of theirs.
"""

from __future__ import annotations

import casadi as ca

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, by_rows, pieces
from valor.robot.model import Model
from valor.whole_body.balance.reference import Feet
from valor.whole_body.model.motion import FEET, Motion, SoleMotions
from valor.whole_body.tasks.task import Period, Task
from valor.whole_body.tuning_tables import Tuning

SWING = (3, 9, 6, 6)  # numbers of ``SwingPoint``'s fields


def sole_rows(foot: int) -> slice:
    """Of one sole (0 left, 1 right) among both soles': linear, then angular."""
    return slice(6 * foot, 6 * foot + 6)


class FootMotion(Task):
    """The soles' linear [m/s²] and angular [rad/s²] accelerations."""

    name = FEET
    weight = "foot"

    @staticmethod
    def motion(model: Model) -> Motion:
        """Of both soles."""
        return SoleMotions(model)

    def acceleration(self, period: Period, velocity: Expression, pose: Expression) -> Expression:
        """(12,) a."""
        table = self.robot.read(Tuning).whole_body
        wanted = -table.foot_damping * velocity
        wanted += ca.if_else(period.steps, 0.0, hold(period.feet, period.stance, table.stance_stiffness))
        for foot in range(2):
            rows = sole_rows(foot)
            wanted[rows] = ca.if_else(period.swinging[foot], self._along(foot, period, velocity[rows]), wanted[rows])
        return wanted

    def weigh(self, weight: float, swinging: int | None, out: FloatArray) -> None:
        """The swinging foot has a weight of its own."""
        out[:] = weight
        if swinging is not None:
            out[sole_rows(swinging)] = self.robot.tables.walking.foot_weight

    def _along(self, foot: int, period: Period, velocity: Expression) -> Expression:
        """(6,) of the swinging sole."""
        place, turn, rate, acceleration = pieces(period.swing, SWING)
        feet, walking = period.feet, self.robot.tables.walking
        away = place - feet.positions[foot, :].T
        turned = rotation.error(by_rows(turn), feet.rotations[3 * foot : 3 * foot + 3, :])
        proportional = walking.foot_stiffness * ca.vertcat(away, *turned)
        return acceleration + proportional + walking.foot_damping * (rate - velocity)


def stance(feet: Feet) -> Expression:
    """(3,) where the left sole is from the right one, ahead and to the left of it [m], and how it is turned [rad]."""
    cosine, sine, x, y, turned = _relative(feet)
    return ca.vertcat(cosine * x + sine * y, cosine * y - sine * x, turned)


def hold(feet: Feet, kept: Expression, stiffness: float) -> Expression:
    """What is wanted of the soles so that they return to a stance.

    Args:
        feet: as they are.
        kept: (3,) the stance.
        stiffness: acceleration per distance from it [1/s²].

    Returns:
        (12,) accelerations in odom, left linear, left angular, right linear, right angular.
    """
    cosine, sine, x, y, turned = _relative(feet)
    ahead, aside, turn = ca.vertsplit(kept)
    left = ca.vertcat(
        cosine * ahead - sine * aside - x, sine * ahead + cosine * aside - y, 0.0, 0.0, 0.0, turn - turned
    )
    return 0.5 * stiffness * ca.vertcat(left, -left)


def _relative(feet: Feet) -> tuple[Expression, Expression, Expression, Expression, Expression]:
    """The right foot's heading (cosine, sine), then the left sole from the right one: x, y in odom [m], yaw [rad]."""
    apart = feet.positions[0, :] - feet.positions[1, :]
    left, right = feet.rotations[:2, 0], feet.rotations[3:5, 0]
    norm = ca.norm_2(right)
    cosine, sine = right[0] / norm, right[1] / norm
    turned = ca.atan2(cosine * left[1] - sine * left[0], cosine * left[0] + sine * left[1])
    return cosine, sine, apart[0], apart[1], turned
