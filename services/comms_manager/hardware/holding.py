"""What devices are told while nobody leads the joints: that nothing is to move."""

from __future__ import annotations

import numpy as np
from msgspec import structs

from valor.common.arrays import FloatArray
from valor.common.messages import JointMode, Motor


def holding(last: Motor, position: FloatArray, effort: FloatArray) -> Motor:
    """Every joint held by its own servo, at rest.

    A servo that led its joint goes on with the set-point that it has: what it carries, it carries on. The others begin
    where their joints are, with the effort that carried these: without it they would sag until their servos carry as
    much. To a servo as soft as a finger's a single noisy measurement of an effort would be a movement.

    Args:
        last: the Motor in force.
        position: (n,) measured [rad].
        effort: (n,) measured [N·m]; NaN: by nothing that measures it.
    """
    led = last.mode == JointMode.POSITION
    zero = np.zeros(position.size)
    return structs.replace(
        last,
        mode=np.full(position.size, JointMode.POSITION, dtype=np.uint8),
        position=np.where(led, last.position, position),
        velocity=zero,
        effort=np.where(led, last.effort, np.nan_to_num(effort)),
        stiffness=zero,
        damping=zero,
    )
