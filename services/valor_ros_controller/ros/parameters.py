"""ROS parameters of the node: declared with a description and a range, read-only or changed at run time.

rclpy refuses what is of another type or out of the range, names the parameter and both, and changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from valor.common.errors import ConfigurationError
from valor.valor_ros_controller.controllers.configuration import Settings, TrajectoryControllerConfig
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


_OF_CONTROLLER: Mapping[str, tuple[str, Range | None]] = {
    "allow_partial_joints_goal": ("joints may be left out of a trajectory", None),
    "action_monitor_rate": ("of feedback [Hz]", RATE),
    "constraints.goal_time": ("how late a goal may be reached [s]; 0: however late", SECONDS),
    "constraints.stopped_velocity_tolerance": ("most velocity at the goal [rad/s or m/s]; 0: not checked", TOLERANCE),
    "constraints.decelerate_on_cancel": ("come to rest with max_deceleration_on_cancel, else at once", None),
}
_OF_EACH_JOINT: Mapping[str, tuple[str, Range]] = {
    "trajectory": ("most error on the way [rad or m]; 0: not checked", TOLERANCE),
    "goal": ("most error at the goal [rad or m]; 0: not checked", TOLERANCE),
    "max_deceleration_on_cancel": ("[rad/s² or m/s²]", DECELERATION),
}


class TrajectoryParameters:
    """The parameters of one trajectory controller, under ``joint_trajectory_controller``'s names.

    Defaults are those of controllers.yaml. The controller's settings are made anew whenever one changes.
    """

    def __init__(
        self, parameters: Parameters, controller: JointTrajectoryController, config: TrajectoryControllerConfig
    ) -> None:
        """Declare them.

        Raises:
            ConfigurationError: one was set at start to what it cannot be.
        """
        self._declare = parameters.declare
        self._controller = controller
        self._values: dict[str, Any] = {}
        for key, about in _OF_CONTROLLER.items():
            self._keep(key, attrgetter(key)(config), about)
        for joint, (key, about_joint) in product(controller.limits.names, _OF_EACH_JOINT.items()):
            self._keep(f"constraints.{joint}.{key}", getattr(config.each_joint, key), about_joint)
        self._apply()

    def _keep(self, key: str, default: Any, about: tuple[str, Range | None]) -> None:
        def change(value: Any) -> None:
            self._values[key] = value
            self._apply()

        self._values[key] = self._declare(f"{self._controller.name}.{key}", default, *about, change)

    def _each_joint(self, key: str) -> list[float]:
        return [self._values[f"constraints.{joint}.{key}"] for joint in self._controller.limits.names]

    def _apply(self) -> None:
        values = self._values
        stopped = values["constraints.stopped_velocity_tolerance"]
        self._controller.settings = Settings(
            allow_partial_joints_goal=values["allow_partial_joints_goal"],
            action_monitor_rate=values["action_monitor_rate"],
            path=Tolerances.default(self._each_joint("trajectory"), 0.0),
            goal=Tolerances.default(self._each_joint("goal"), stopped),
            goal_time=values["constraints.goal_time"],
            decelerate_on_cancel=values["constraints.decelerate_on_cancel"],
            max_deceleration=np.array(self._each_joint("max_deceleration_on_cancel")),
        )
