"""Footsteps that a controller takes, and the interface of their sources."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from valor.common.arrays import FloatArray
from valor.robot import footsteps


@dataclass(slots=True)
class SolePose:
    """Pose of a sole in odom."""

    position: FloatArray  # (3,) [m]
    rotation: FloatArray  # (3, 3)


Step = footsteps.Step[SolePose]


class StepSource(Protocol):
    """Source of the gait's steps."""

    def upcoming(self, soles: Sequence[SolePose]) -> Sequence[Step]:
        """Return the steps to come, the next first, for the left and right sole on the ground; none: stand."""

    def began(self, step: Step) -> None:
        """Called when the first of the upcoming steps starts."""

    def ended(self, step: Step) -> None:
        """Called when its foot is on the ground."""

    def rested(self) -> None:
        """Called when the robot stands on both feet, at rest."""
