"""Table of controllers, ``controllers.yaml``, and their types: those of this package and of installed ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Self, TypeVar

from valor.common.errors import expected
from valor.common.table import Table, TableError, checked, read
from valor.robot.description import RobotDescription
from valor.valor_ros_controller.controller_manager import Controller, Resources
from valor.valor_ros_controller.controllers.balance_controller import BalanceController
from valor.valor_ros_controller.controllers.configuration import ControllerConfig, TrajectoryControllerConfig
from valor.valor_ros_controller.controllers.gravity_offset import GravityOffset
from valor.valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController
from valor.valor_ros_controller.controllers.tracking import FootstepController, TrackingController

FILE = Path(__file__).parent.parent / "controllers.yaml"
GROUP = "valor.ros_controllers"
"""Entry points of installed packages: a type in the form of a ros2_control plug-in, and its ``Controller``."""
TYPES: Mapping[str, type[Controller]] = {
    each.type: each
    for each in (JointTrajectoryController, TrackingController, FootstepController, GravityOffset, BalanceController)
}
"""Types of this package."""

C = TypeVar("C", bound=ControllerConfig)


def controller_type(name: str) -> type[Controller]:
    """Return the class of a type. Raises ValueError: there is none, or it has another type."""
    if name in TYPES:
        return TYPES[name]
    installed = {entry.name: entry for entry in entry_points(group=GROUP)}
    if name not in installed:
        raise ValueError(f"unknown type {expected(name, [*TYPES, *installed])}")
    found: type[Controller] = installed[name].load()
    if found.type != name:
        raise ValueError(f"{installed[name].value}: its type is {found.type!r}; expected its entry point's, {name!r}")
    return found


def _config(name: object, entry: Mapping[str, Any]) -> ControllerConfig:
    if not isinstance(name, str):
        raise TableError(("type",), f"got {name!r}; expected one of {', '.join(TYPES)}")
    try:
        kind = controller_type(name)
    except ValueError as error:
        raise TableError(("type",), str(error)) from None
    return checked(kind.config, entry)


class _File(Table):
    namespace: str
    defaults: dict[str, Any]  # for references within the file
    legs: dict[str, Any]  # for references within the file
    joint_controllers: dict[str, dict[str, Any]]
    robot_controllers: dict[str, dict[str, Any]]

    def __post_init__(self) -> None:
        for manager in ("joint_controllers", "robot_controllers"):
            self.of(manager)

    def of(self, manager: str) -> dict[str, ControllerConfig]:
        """Configurations of a manager's controllers by name. Raises TableError: an entry is invalid."""
        made = {}
        for name, entry in getattr(self, manager).items():
            try:
                made[name] = _config(entry.get("type"), entry)
            except TableError as error:
                raise TableError((manager, name, *error.path), error.what) from None
        return made


@dataclass(frozen=True)
class ControllersTable:
    """``controllers.yaml``: configurations by name, those of the joint manager and of the robot manager."""

    namespace: str
    joint_controllers: dict[str, ControllerConfig]
    robot_controllers: dict[str, ControllerConfig]

    @classmethod
    def load(cls, file: Path = FILE) -> Self:
        """Read the table. Raises ConfigurationError: the file, a key or a type is missing or invalid."""
        content = read(_File, file)
        return cls(content.namespace, content.of("joint_controllers"), content.of("robot_controllers"))

    def of(self, robot: RobotDescription) -> Self:
        """Return the table without controllers that a robot lacks."""

        def present(configs: dict[str, ControllerConfig]) -> dict[str, ControllerConfig]:
            return {name: each for name, each in configs.items() if controller_type(each.type).fits(each, robot)}

        joint, robots = present(self.joint_controllers), present(self.robot_controllers)
        return replace(self, joint_controllers=joint, robot_controllers=robots)

    def bases(self, name: str) -> tuple[str, str]:
        """Prefixes of a controller's interface names: ViGIR's, then ros2_control's."""
        return f"{self.namespace}/{name}", name

    @property
    def all(self) -> dict[str, ControllerConfig]:
        """Configurations of both managers."""
        return self.joint_controllers | self.robot_controllers

    def of_type(self, kind: type[C]) -> dict[str, C]:
        """Return the configurations of a type."""
        return {name: config for name, config in self.all.items() if isinstance(config, kind)}

    @property
    def manipulate(self) -> bool:
        """True if any controller moves arms, hands or waist."""
        return any("manipulation" in each.accepted_when for each in self.of_type(TrajectoryControllerConfig).values())


def make_controllers(configs: Mapping[str, ControllerConfig], resources: Resources) -> list[Controller]:
    """Create the controllers of a manager, in their order."""
    return [controller_type(each.type).make(name, each, resources) for name, each in configs.items()]
