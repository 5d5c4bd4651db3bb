"""The table of trajectory controllers, ``controllers.yaml``, and what of it can change while they run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

import numpy as np
from msgspec import Meta, field, structs

from valor.common.arrays import FloatArray
from valor.common.table import NonNegative, Positive, Table, read
from valor.robot.description import RobotDescription
from valor.valor_ros_controller.trajectory.tolerances import Tolerances
from valor.valor_ros_controller.valor_escher_hw_interface import PELVIS

FILE = Path(__file__).parent.parent / "controllers.yaml"

_Rate = Annotated[float, Meta(ge=0.1, le=500.0)]


class Constraints(Table):
    """Default tolerances of a goal."""

    stopped_velocity_tolerance: NonNegative  # at the goal [rad/s]; 0: not checked
    goal_time: NonNegative  # how late the goal may be reached [s]; 0: however late
    decelerate_on_cancel: bool


class EachJoint(Table):
    """Defaults for every joint of a controller."""

    trajectory: NonNegative  # [rad or m]; 0: not checked
    goal: NonNegative  # [rad or m]; 0: not checked
    max_deceleration_on_cancel: Positive  # [1/s²]


class TrajectoryControllerConfig(Table):
    """A controller that runs trajectories."""

    groups: tuple[str, ...]
    accepted_when: dict[str, str]
    allow_partial_joints_goal: bool
    action_monitor_rate: _Rate
    state_publish_rate: _Rate
    constraints: Constraints
    each_joint: EachJoint


class TrackingControllerConfig(Table):
    """A controller that follows what the robot does."""

    groups: tuple[str, ...]
    state_publish_rate: _Rate
    goals: str


C = TypeVar("C", TrajectoryControllerConfig, TrackingControllerConfig)


class ControllersTable(Table):
    """``controllers.yaml``."""

    namespace: str
    defaults: dict[str, Any]  # named only to be referred to within the file
    legs: dict[str, Any]  # likewise
    joint_controllers: dict[str, TrajectoryControllerConfig]
    tracking_controllers: dict[str, TrackingControllerConfig]
    robot_controllers: dict[str, TrajectoryControllerConfig] = field(default_factory=dict)

    @classmethod
    def load(cls, file: Path = FILE) -> ControllersTable:
        """Read the table.

        Raises:
            ConfigurationError: the file or a key is missing or wrong.
        """
        return read(cls, file)

    def of(self, robot: RobotDescription) -> Self:
        """Those whose limb a robot has: a controller of no joints is none."""

        def there(controllers: dict[str, C]) -> dict[str, C]:
            return {
                name: config
                for name, config in controllers.items()
                if any(group == PELVIS or robot.tables.group(group) for group in config.groups)
            }

        return structs.replace(
            self,
            joint_controllers=there(self.joint_controllers),
            tracking_controllers=there(self.tracking_controllers),
            robot_controllers=there(self.robot_controllers),
        )

    def bases(self, name: str) -> tuple[str, str]:
        """What the names of a controller's interfaces begin with: ViGIR's, then ros2_control's."""
        return f"{self.namespace}/{name}", name

    @property
    def manipulate(self) -> bool:
        """Whether any of them leads arms, hands or waist."""
        return any("manipulation" in config.accepted_when for config in self.joint_controllers.values())

    @property
    def names(self) -> frozenset[str]:
        """Of all controllers."""
        return frozenset((*self.joint_controllers, *self.tracking_controllers, *self.robot_controllers))


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
    max_deceleration: FloatArray

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
