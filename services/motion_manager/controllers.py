"""Controllers of a robot beside the Whole-Body Controller, from the names in ``controllers`` of robot.yaml.

A name is that of an installed package's entry point in the group ``valor.controllers``, or of a policy of the robot.
"""

from __future__ import annotations

from functools import partial
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from valor.common.errors import ConfigurationError
from valor.control.controller import Controller, ControllerFactory
from valor.control.kinematics import Kinematics
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import WHOLE_BODY

GROUP = "valor.controllers"


def controller_factories(robot: RobotDescription) -> list[ControllerFactory]:
    """Return one factory for each name. Raises ConfigurationError: there is no such controller or policy."""
    installed = {each.name: each for each in entry_points(group=GROUP)}
    names = dict.fromkeys(name for each in robot.tables.controllers.names().values() for name in each)
    return [
        partial(_installed, installed[name]) if name in installed else partial(policy_controller, _file(name, robot))
        for name in names
        if name != WHOLE_BODY
    ]


def _installed(entry: EntryPoint, robot: RobotDescription, kinematics: Kinematics) -> Controller:
    controller: Controller = entry.load()(robot, kinematics)
    if controller.name != entry.name:
        raise ConfigurationError(
            f"controller {entry.value}: its name is {controller.name!r}; expected its entry point's, {entry.name!r}"
        )
    return controller


def policy_controller(file: Path, robot: RobotDescription, kinematics: Kinematics) -> Controller:
    """Return the controller of a policy's ONNX file. Raises ConfigurationError, with all that is wrong with it."""
    # onnxruntime is needed by robots with policies only.
    from valor.policies.contract import load
    from valor.policies.controller import PolicyController
    from valor.policies.policy import Policy

    return PolicyController(Policy(load(file, robot), robot), robot)


def _file(name: str, robot: RobotDescription) -> Path:
    file = robot.folder / "policies" / f"{name}.onnx"
    if not file.is_file():
        known = ", ".join(sorted(each.stem for each in file.parent.glob("*.onnx"))) or "none"
        raise robot.error(
            ("controllers",),
            f"no controller {name!r}; expected {WHOLE_BODY}, an installed one (entry points {GROUP}), or a policy in "
            f"{file.parent} ({known}); `valorctl policy add FILE` adds one",
        )
    return file
