"""Footsteps: where the next ones come from."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from typing import Protocol

import numpy as np

from valor.common import rotation
from valor.robot import footsteps
from valor.robot.footsteps import LEFT
from valor.whole_body.walking.swing import SolePose

ALIGNED = (0.02, 0.05)  # feet so well side by side need no closing step [m, rad]


Step = footsteps.Step[SolePose]


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
