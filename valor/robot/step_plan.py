"""Footstep plans as people write them: a YAML file with the feet one after the other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from valor.common.poses import Pose, level
from valor.common.table import Table, read

FEET = ("left", "right")
START = "feet"  # the frame midway between the soles as they stand


class PlanStep(Table):
    """Where one sole goes, in the plan's frame."""

    foot: Literal["left", "right"]
    x: float  # [m]
    y: float  # [m]
    z: float = 0.0  # [m]
    yaw: float = 0.0  # [rad]
    swing_height: float = 0.0  # [m]; 0: the robot's default
    step_duration: float = 0.0  # of the swing [s]; 0: the robot's default
    sway_duration: float = 0.0  # of the double support before it [s]; 0: the robot's default

    @property
    def sole(self) -> Pose:
        """Its pose in the plan's frame."""
        return level(self.x, self.y, self.z, self.yaw)


class StepPlanFile(Table, kw_only=True):
    """A plan."""

    description: str = ""
    frame: Annotated[str, Meta(min_length=1)] = START  # or one that tf knows, such as odom
    steps: Annotated[list[PlanStep], Meta(min_length=1)]


def load(file: Path) -> StepPlanFile:
    """Read a plan.

    Raises:
        ConfigurationError: it cannot be read, or a key is wrong; names file and key.
    """
    return read(StepPlanFile, file)
