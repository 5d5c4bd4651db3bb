"""Configurations of the controllers in ``controllers.yaml``, and settings that change at run time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Self

import numpy as np
from msgspec import Meta, structs

from valor.common.arrays import FloatArray
from valor.common.table import NonNegative, Positive, Table
from valor.valor_ros_controller.trajectory.waypoints import Tolerances

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


class ControllerConfig(Table):
    """Any controller."""

    type: str  # in the form of a ros2_control plug-in
    groups: tuple[str, ...] = ()  # of robot.yaml, or the pelvis; a robot without any of them lacks the controller


class TrajectoryControllerConfig(ControllerConfig, kw_only=True):
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


class TrackingControllerConfig(ControllerConfig, kw_only=True):
    """Tracking controller, which follows the robot."""

    groups: tuple[str, ...]
    state_publish_rate: _Rate
    goals: str


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
