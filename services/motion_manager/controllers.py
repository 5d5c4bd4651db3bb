"""Controllers of a robot beside the Whole-Body Controller, from the names in ``controllers`` of robot.yaml.

Which there are: ``valor.robot.checks.controllers``.
"""

from __future__ import annotations

from functools import partial
from importlib.metadata import EntryPoint
from pathlib import Path

from valor.common.errors import ConfigurationError, SeveralFaultsError
from valor.control.controller import Controller, ControllerFactory
from valor.control.kinematics import Kinematics
from valor.robot.checks.controllers import controllers_exist, installed, others, policy_file
from valor.robot.description import RobotDescription


def controller_factories(robot: RobotDescription) -> list[ControllerFactory]:
    """Return one factory for each name. Raises ConfigurationError: there is no such controller or policy."""
    SeveralFaultsError.require_none(robot.error(each.path, each.what) for each in controllers_exist(robot))
    found = installed()
    return [
        partial(_installed, found[name]) if name in found else partial(policy_controller, policy_file(robot, name))
        for name in others(robot)
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
