"""Table of controllers, ``controllers.yaml``, and settings that change at run time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from msgspec import Meta, field, structs

from valor.common.arrays import FloatArray
from valor.common.table import NonNegative, Positive, Table, read
from valor.robot.description import RobotDescription
from valor.valor_ros_controller.trajectory.waypoints import Tolerances
from valor.valor_ros_controller.valor_escher_hw_interface import PELVIS

FILE = Path(__file__).parent.parent / "controllers.yaml"

_Rate = Annotated[float, Meta(ge=0.1, le=500.0)]


class Constraints(Table):
    """Default tolerances of a goal."""

    stopped_velocity_tolerance: NonNegative  # at the goal [rad/s or m/s]; 0: not checked
    goal_time: NonNegative  # largest delay of the goal [s]; 0: unlimited
    decelerate_on_cancel: bool


class EachJoint(Table):
    """Defaults for every joint of a controller."""

    trajectory: NonNegative  # [rad or m]; 0: not checked
    goal: NonNegative  # [rad or m]; 0: not checked
    max_deceleration_on_cancel: Positive  # [1/s²]


class TrajectoryControllerConfig(Table):
    """Trajectory controller."""

    groups: tuple[str, ...]
    accepted_when: dict[str, str]
    allow_partial_joints_goal: bool
    action_monitor_rate: _Rate
    state_publish_rate: _Rate
    constraints: Constraints
    each_joint: EachJoint

    def parameters(self, joints: Sequence[str]) -> dict[str, Any]:
        """Defaults of the ROS parameters by name, without the rate of the state."""
        values: dict[str, Any] = {
            "allow_partial_joints_goal": self.allow_partial_joints_goal,
            "action_monitor_rate": self.action_monitor_rate,
            **{f"constraints.{key}": value for key, value in structs.asdict(self.constraints).items()},
        }
        for joint in joints:
            values |= {f"constraints.{joint}.{key}": value for key, value in structs.asdict(self.each_joint).items()}
        return values


class TrackingControllerConfig(Table):
    """Tracking controller, which follows the robot."""

    groups: tuple[str, ...]
    state_publish_rate: _Rate
    goals: str


class OffsetControllerConfig(Table):
    """Controller of offsets that are added to the commands of others."""

    groups: tuple[str, ...]


class ControllersTable(Table):
    """``controllers.yaml``."""

    namespace: str
    defaults: dict[str, Any]  # for references within the file
    legs: dict[str, Any]  # for references within the file
    joint_controllers: dict[str, TrajectoryControllerConfig]
    tracking_controllers: dict[str, TrackingControllerConfig]
    robot_controllers: dict[str, TrajectoryControllerConfig] = field(default_factory=dict)
    offset_controllers: dict[str, OffsetControllerConfig] = field(default_factory=dict)

    @classmethod
    def load(cls, file: Path = FILE) -> Self:
        """Read the table. Raises ConfigurationError: the file or a key is missing or invalid."""
        return read(cls, file)

    def of(self, robot: RobotDescription) -> Self:
        def present(controllers: dict[str, Any]) -> dict[str, Any]:
            return {
                name: config
                for name, config in controllers.items()
                if any(group == PELVIS or robot.tables.group(group) for group in config.groups)
            }

        return structs.replace(
            self,
            joint_controllers=present(self.joint_controllers),
            tracking_controllers=present(self.tracking_controllers),
            robot_controllers=present(self.robot_controllers),
            offset_controllers=present(self.offset_controllers),
        )

    def bases(self, name: str) -> tuple[str, str]:
        """Prefixes of a controller's interface names: ViGIR's, then ros2_control's."""
        return f"{self.namespace}/{name}", name

    @property
    def manipulate(self) -> bool:
        """Whether any controller moves arms, hands or waist."""
        return any("manipulation" in config.accepted_when for config in self.joint_controllers.values())

    @property
    def names(self) -> frozenset[str]:
        controllers = (self.joint_controllers, self.tracking_controllers, self.robot_controllers)
        return frozenset(name for each in (*controllers, self.offset_controllers) for name in each)


@dataclass(frozen=True)
class Settings:
    """Settings of a controller of n joints, effective from its next trajectory."""

    allow_partial_joints_goal: bool  # a trajectory may leave joints out
    action_monitor_rate: float  # of feedback [Hz]
    path: Tolerances  # default
    goal: Tolerances  # default
    goal_time: float  # largest delay of the goal [s]; 0: unlimited
    decelerate_on_cancel: bool  # stop with ``max_deceleration``, else at once
    max_deceleration: FloatArray  # (n,) [1/s²]

    @classmethod
    def of(cls, values: Mapping[str, Any], joints: Sequence[str]) -> Self:
        def each_joint(key: str) -> list[float]:
            return [values[f"constraints.{joint}.{key}"] for joint in joints]

        return cls(
            values["allow_partial_joints_goal"],
            values["action_monitor_rate"],
            Tolerances.default(each_joint("trajectory"), 0.0),
            Tolerances.default(each_joint("goal"), values["constraints.stopped_velocity_tolerance"]),
            values["constraints.goal_time"],
            values["constraints.decelerate_on_cancel"],
            np.array(each_joint("max_deceleration_on_cancel")),
        )
