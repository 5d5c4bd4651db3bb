"""Footsteps: what a step is, where the next ones come from, and which a robot can take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import acos, cos, hypot, remainder, sin, tau
from typing import Protocol

import numpy as np

from valor.common import rotation
from valor.motion_manager.whole_body.walking.swing import SolePose
from valor.robot.motion_tables import Footsteps

LEFT, RIGHT = 0, 1
FEET = ("left", "right")
ALIGNED = (0.02, 0.05)  # feet so well side by side need no closing step [m, rad]


@dataclass(frozen=True, slots=True)
class Step:
    """One step."""

    index: int
    foot: int  # LEFT or RIGHT
    sole: SolePose  # where it ends, in odom
    swing_height: float  # [m]
    swing_duration: float  # [s]
    transfer_duration: float  # of the double support before [s]
    adjustable: float = 0.0  # how far the robot may move it, either way along each axis, to keep its balance [m]


class StepSource(Protocol):
    """Where the gait gets its steps from."""

    def upcoming(self, soles: Sequence[SolePose]) -> Sequence[Step]:
        """The steps to come, the next first; none: stand. Asked when weight is about to be transferred.

        Args:
            soles: of the left and right foot, both on the ground.
        """

    def began(self, step: Step) -> None:
        """The first of the upcoming steps is being taken now."""

    def ended(self, step: Step) -> None:
        """Its foot is on the ground."""

    def rested(self) -> None:
        """The robot stands on both feet, at rest."""


def reach_refusal(step: Step, other: SolePose, limits: Footsteps) -> str:
    """Why a step is beyond reach of the other foot; an empty text: it is not.

    Args:
        step: it.
        other: the sole of the other foot meanwhile.
        limits: of the robot.
    """
    x, y, up = (step.sole.position - other.position).tolist()
    heading = rotation.yaw(other.rotation)
    c, s = cos(heading), sin(heading)
    forward, lateral = c * x + s * y, c * y - s * x
    width = lateral if step.foot == LEFT else -lateral
    yaw = remainder(rotation.yaw(step.sole.rotation) - heading, tau)
    tilt = acos(min(1.0, max(-1.0, float(step.sole.rotation[2, 2]))))
    checks = (
        ("forward", forward, -limits.max_backward, limits.max_forward, "m"),
        ("apart", width, limits.min_width, limits.max_width, "m"),
        ("up", up, -limits.max_down, limits.max_up, "m"),
        ("turned", yaw, -limits.max_yaw, limits.max_yaw, "rad"),
        ("tilted", tilt, 0.0, limits.max_tilt, "rad"),
    )
    for what, value, low, high, unit in checks:
        if not low - 1e-6 <= value <= high + 1e-6:
            return (
                f"step {step.index} ({FEET[step.foot]}) is {value:.3f} {unit} {what} of the other foot; "
                f"expected {low} to {high} {unit}"
            )
    return ""


def level_pose(x: float, y: float, z: float, yaw: float) -> SolePose:
    """A level sole in odom [m, rad]."""
    return SolePose(np.array((x, y, z)), rotation.yaw_matrix(yaw))


def beside(stance: SolePose, foot: int, width: float) -> SolePose:
    """A level sole of ``foot`` beside the other's, parallel to it, ``width`` [m] between their origins."""
    yaw = rotation.yaw_matrix(rotation.yaw(stance.rotation))
    return SolePose(stance.position + yaw @ np.array((0.0, width if foot == LEFT else -width, 0.0)), yaw)


def side_by_side(sole: SolePose, place: SolePose) -> bool:
    """Whether a sole is so near to its place beside the other that a step there would not change much."""
    way, turn = place.position - sole.position, place.rotation @ sole.rotation.T
    return hypot(float(way[0]), float(way[1])) < ALIGNED[0] and abs(rotation.yaw(turn)) < ALIGNED[1]
