"""Factories of controllers by their name in robot.yaml: those of installed packages, and policies.

Which there are: ``valor.robot.checks.controllers``.
"""

from __future__ import annotations

from functools import partial
from importlib.metadata import EntryPoint
from pathlib import Path

from valor.common.errors import ConfigurationError
from valor.control.controller import Controller, ControllerFactory
from valor.control.kinematics import Kinematics
from valor.robot.checks.controllers import installed, policy_file
from valor.robot.description import RobotDescription


def controller_factory(robot: RobotDescription, name: str) -> ControllerFactory:
    """Return the factory of an installed controller, or else of a policy, which may be missing."""
    found = installed().get(name)
    return partial(_installed, found) if found else partial(policy_controller, policy_file(robot, name))


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
