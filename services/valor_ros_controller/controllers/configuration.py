"""The table of trajectory controllers, ``controllers.yaml``, and what of it can change while they run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from valor_ros_controller.control_modes import load_table
from valor_ros_controller.trajectory.limits import Vector
from valor_ros_controller.trajectory.tolerances import Tolerances

FILE = Path(__file__).parent.parent / "controllers.yaml"

_NonNegative = Annotated[float, Field(ge=0)]
_Rate = Annotated[float, Field(ge=0.1, le=500.0)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Constraints(_Table):
    """Default tolerances of a goal."""

    stopped_velocity_tolerance: _NonNegative  # at the goal [rad/s]; 0: not checked
    goal_time: _NonNegative  # how late the goal may be reached [s]; 0: however late
    decelerate_on_cancel: bool


class EachJoint(_Table):
    """Defaults for every joint of a controller."""

    trajectory: _NonNegative  # [rad or m]; 0: not checked
    goal: _NonNegative  # [rad or m]; 0: not checked
    max_deceleration_on_cancel: Annotated[float, Field(gt=0)]  # [1/s²]


class TrajectoryControllerConfig(_Table):
    """A controller that runs trajectories."""

    groups: tuple[str, ...]
    accepted_when: dict[str, str]
    allow_partial_joints_goal: bool
    action_monitor_rate: _Rate
    state_publish_rate: _Rate
    constraints: Constraints
    each_joint: EachJoint


class TrackingControllerConfig(_Table):
    """A controller that follows what the robot does."""

    groups: tuple[str, ...]
    state_publish_rate: _Rate
    goals: str


class ControllersTable(_Table):
    """``controllers.yaml``."""

    namespace: str
    defaults: dict[str, object]  # named only to be referred to within the file
    legs: dict[str, object]  # likewise
    joint_controllers: dict[str, TrajectoryControllerConfig]
    tracking_controllers: dict[str, TrackingControllerConfig]
    robot_controllers: dict[str, TrajectoryControllerConfig] = {}

    @classmethod
    def load(cls, file: Path = FILE) -> ControllersTable:
        """Read the table.

        Raises:
            ConfigurationError: the file or a key is missing or wrong.
        """
        return load_table(cls, file)


@dataclass(frozen=True)
class Settings:
    """What may change while a controller of n joints runs; the next trajectory is run by it.

    Attributes:
        allow_partial_joints_goal: whether a trajectory may leave joints out.
        action_monitor_rate: of feedback [Hz].
        path, goal: default tolerances.
        goal_time: how late the goal may be reached [s]; 0: however late.
        decelerate_on_cancel: to rest, else at once.
        max_deceleration: (n,) [1/s²].
    """

    allow_partial_joints_goal: bool
    action_monitor_rate: float
    path: Tolerances
    goal: Tolerances
    goal_time: float
    decelerate_on_cancel: bool
    max_deceleration: Vector

    @classmethod
    def of(cls, config: TrajectoryControllerConfig, n: int) -> Settings:
        """The table's own."""
        constraints, each = config.constraints, config.each_joint
        return cls(
            config.allow_partial_joints_goal,
            config.action_monitor_rate,
            Tolerances.default([each.trajectory] * n, 0.0),
            Tolerances.default([each.goal] * n, constraints.stopped_velocity_tolerance),
            constraints.goal_time,
            constraints.decelerate_on_cancel,
            np.full(n, each.max_deceleration_on_cancel),
        )
