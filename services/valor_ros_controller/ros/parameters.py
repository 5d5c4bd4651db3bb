"""ROS parameters of the node: declared with a description and a range, read-only or changed at run time.

rclpy refuses what is of another type or out of the range, names the parameter and both, and changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.valor_ros_controller.controllers.configuration import (
    Settings,
    TrajectoryControllerConfig,
)
from valor.valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController
from valor.valor_ros_controller.trajectory.tolerances import Tolerances

T = TypeVar("T", bool, float)


@dataclass(frozen=True)
class Range:
    """What a number may be."""

    lowest: float
    highest: float


TOLERANCE = Range(0.0, 100.0)
RATE = Range(0.1, 500.0)
SECONDS = Range(0.0, 3600.0)
DECELERATION = Range(0.01, 1000.0)


@dataclass(frozen=True)
class _EachJoint:
    """A parameter that every joint has."""

    key: str
    description: str
    values: Range


_PATH = _EachJoint("trajectory", "most error on the way [rad or m]; 0: not checked", TOLERANCE)
_GOAL = _EachJoint("goal", "most error at the goal [rad or m]; 0: not checked", TOLERANCE)
_MAX_DECELERATION = _EachJoint("max_deceleration_on_cancel", "[rad/s² or m/s²]", DECELERATION)


class Parameters:
    """Declares the node's parameters, and tells of changes."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._changes: dict[str, Callable[[Any], None]] = {}
        node.add_post_set_parameters_callback(self._changed)

    def declare(
        self,
        name: str,
        default: T,
        description: str,
        values: Range | None = None,
        on_change: Callable[[Any], None] | None = None,
    ) -> T:
        """Declare a parameter and read it.

        Args:
            name: of the parameter.
            default: its value unless it was set at start.
            description: for people, with the unit.
            values: what it may be.
            on_change: is given every new value, in the ROS thread; None: the parameter is read-only.

        Raises:
            ConfigurationError: it was set at start to a value of another type or out of range.
        """
        descriptor = ParameterDescriptor(description=description, read_only=on_change is None)
        if values:
            descriptor.floating_point_range = [FloatingPointRange(from_value=values.lowest, to_value=values.highest)]
        try:
            parameter: Parameter = self._node.declare_parameter(name, default, descriptor)
        except Exception as error:
            expected = f"{values.lowest:g} to {values.highest:g}" if values else f"as {default!r}"
            raise ConfigurationError(f"ROS parameter {name}: {error}; expected {expected}") from None
        if on_change:
            self._changes[name] = on_change
        value: T = parameter.value
        return value

    def refuse_changes(self, reason: str) -> None:
        """From now on refuse every change, and say why."""
        refused = SetParametersResult(successful=False, reason=reason)
        self._node.add_on_set_parameters_callback(lambda _: refused)

    def _changed(self, parameters: Sequence[Parameter]) -> None:
        for parameter in parameters:
            if on_change := self._changes.get(parameter.name):
                on_change(parameter.value)


class TrajectoryParameters:
    """The parameters of one trajectory controller, under ``joint_trajectory_controller``'s names.

    Its settings are made anew from all of them whenever one changes.
    """

    def __init__(
        self, parameters: Parameters, controller: JointTrajectoryController, config: TrajectoryControllerConfig
    ) -> None:
        """Declare them.

        Raises:
            ConfigurationError: one was set at start to what it cannot be.
        """
        self._controller = controller
        self._declare = parameters.declare
        self._prefix = controller.name
        constraints, each = config.constraints, config.each_joint
        n = len(controller.joints)
        self._partial = self._keep(
            "allow_partial_joints_goal", config.allow_partial_joints_goal, "joints may be left out of a trajectory"
        )
        self._monitor_rate = self._keep("action_monitor_rate", config.action_monitor_rate, "of feedback [Hz]", RATE)
        self._goal_time = self._keep(
            "constraints.goal_time",
            constraints.goal_time,
            "how late a goal may be reached [s]; 0: however late",
            SECONDS,
        )
        self._stopped = self._keep(
            "constraints.stopped_velocity_tolerance",
            constraints.stopped_velocity_tolerance,
            "most velocity at the goal [rad/s or m/s]; 0: not checked",
            TOLERANCE,
        )
        self._decelerate = self._keep(
            "constraints.decelerate_on_cancel",
            constraints.decelerate_on_cancel,
            "come to rest with max_deceleration_on_cancel, else at once",
        )
        self._path, self._goal, self._deceleration = np.zeros((3, n))
        for kept, each_joint, default in (
            (self._path, _PATH, each.trajectory),
            (self._goal, _GOAL, each.goal),
            (self._deceleration, _MAX_DECELERATION, each.max_deceleration_on_cancel),
        ):
            for i, joint in enumerate(controller.limits.names):
                self._keep_at(kept, i, joint, each_joint, default)
        self._apply()

    def _keep(self, key: str, default: T, description: str, values: Range | None = None) -> list[T]:
        """A parameter's value, in a list of one that changes with it."""
        kept: list[T] = []

        def change(value: T) -> None:
            kept[0] = value
            self._apply()

        kept.append(self._declare(f"{self._prefix}.{key}", default, description, values, change))
        return kept

    def _keep_at(self, kept: FloatArray, place: int, joint: str, each: _EachJoint, default: float) -> None:
        """A parameter's value, at a place of a vector."""

        def change(value: float) -> None:
            kept[place] = value
            self._apply()

        name = f"{self._prefix}.constraints.{joint}.{each.key}"
        kept[place] = self._declare(name, default, each.description, each.values, change)

    def _apply(self) -> None:
        self._controller.settings = Settings(
            allow_partial_joints_goal=self._partial[0],
            action_monitor_rate=self._monitor_rate[0],
            path=Tolerances.default(self._path.tolist(), 0.0),
            goal=Tolerances.default(self._goal.tolist(), self._stopped[0]),
            goal_time=self._goal_time[0],
            decelerate_on_cancel=self._decelerate[0],
            max_deceleration=self._deceleration.copy(),
        )
