"""Controllers of a robot beside the Whole-Body Controller, from the names in ``controllers`` of robot.yaml."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from valor.control.controller import Controller, ControllerFactory
from valor.control.kinematics import Kinematics
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import WHOLE_BODY


def controller_factories(robot: RobotDescription) -> list[ControllerFactory]:
    """Return one factory for each name. Raises ConfigurationError: there is no such controller or policy."""
    names = dict.fromkeys(name for each in robot.tables.controllers.names().values() for name in each)
    return [partial(policy_controller, _file(name, robot)) for name in names if name != WHOLE_BODY]


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
            f"no controller {name!r}; expected {WHOLE_BODY} or a policy in {file.parent} ({known}); "
            "`valorctl policy add` adds one",
        )
    return file
