"""The trajectory controllers' ROS parameters."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from operator import attrgetter
from typing import Any

import numpy as np

from valor.ros.parameters import Parameters, Range
from valor.valor_ros_controller.controllers.configuration import Settings, TrajectoryControllerConfig
from valor.valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController
from valor.valor_ros_controller.trajectory.tolerances import Tolerances

TOLERANCE = Range(0.0, 100.0)
RATE = Range(0.1, 500.0)
SECONDS = Range(0.0, 3600.0)
DECELERATION = Range(0.01, 1000.0)


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
