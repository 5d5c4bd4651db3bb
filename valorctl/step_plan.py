"""Footstep plans as people write them: a YAML file with the feet one after the other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from valor_common.errors import ConfigurationError
from valor_common.poses import Pose, level

FEET = ("left", "right")
START = "feet"  # the frame midway between the soles as they stand

_Number = Annotated[float, Field(allow_inf_nan=False)]


class PlanStep(BaseModel):
    """Where one sole goes, in the plan's frame."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    foot: Literal["left", "right"]
    x: _Number  # [m]
    y: _Number  # [m]
    z: _Number = 0.0  # [m]
    yaw: _Number = 0.0  # [rad]
    swing_height: _Number = 0.0  # [m]; 0: the robot's default
    step_duration: _Number = 0.0  # of the swing [s]; 0: the robot's default
    sway_duration: _Number = 0.0  # of the double support before it [s]; 0: the robot's default

    @property
    def sole(self) -> Pose:
        """Its pose in the plan's frame."""
        return level(self.x, self.y, self.z, self.yaw)


class StepPlanFile(BaseModel):
    """A plan."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    description: str = ""
    frame: Annotated[str, Field(min_length=1)] = START  # or one that tf knows, such as odom
    steps: Annotated[list[PlanStep], Field(min_length=1)]


def load(file: Path) -> StepPlanFile:
    """Read a plan.

    Raises:
        ConfigurationError: it cannot be read, or a key is wrong; names file and key.
    """
    try:
        return StepPlanFile.model_validate(yaml.safe_load(file.read_text()))
    except OSError as error:
        raise ConfigurationError(f"{file}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{file}: expected text") from None
    except yaml.YAMLError as error:
        raise ConfigurationError(f"{file}: {' '.join(str(error).split())}") from None
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"])) or "the file"
        raise ConfigurationError(f"{file}: {key}: {first['msg']}") from None
