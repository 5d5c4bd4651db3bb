"""How the feet stand to each other, held against creep.

What the model has wrong makes the legs push the feet apart, and however little they creep, over an hour it is a split.
The ground tells nothing about it, but the encoders do: each foot is drawn back by half of what they have moved apart
or turned towards each other. Where both feet are together is no business of theirs.
"""

from __future__ import annotations

import casadi as ca

from valor.motion_manager.kernel import Expression
from valor.motion_manager.whole_body.balance.reference import Feet


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
