"""Controllers that robot.yaml names: policies in the robot's folder, and those of installed packages."""

from collections.abc import Iterator
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from valor.common.table import TableError
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import WHOLE_BODY

GROUP = "valor.controllers"
"""Entry points of installed packages: a name, and a ``ControllerFactory``."""


def installed() -> dict[str, EntryPoint]:
    """Return the controllers of installed packages by name."""
    return {each.name: each for each in entry_points(group=GROUP)}


def policy_file(robot: RobotDescription, name: str) -> Path:
    """Return the file of a robot's policy, which may be missing."""
    return robot.folder / "policies" / f"{name}.onnx"


def others(robot: RobotDescription) -> list[str]:
    """Return the names in ``controllers`` beside the Whole-Body Controller, each once."""
    named = robot.tables.controllers.names().values()
    return [name for name in dict.fromkeys(name for each in named for name in each) if name != WHOLE_BODY]


def controllers_exist(robot: RobotDescription) -> Iterator[TableError]:
    """Check that every controller in robot.yaml is a policy of the robot or of an installed package."""
    known = installed()
    for name in others(robot):
        if name not in known and not policy_file(robot, name).is_file():
            there = sorted(each.stem for each in policy_file(robot, name).parent.glob("*.onnx"))
            yield TableError(
                ("controllers",),
                f"no controller {name!r}; expected {WHOLE_BODY}, an installed one ({', '.join(known) or 'none is'}), "
                f"or a policy of the robot ({', '.join(there) or 'it has none'}); `valorctl policy add FILE` adds one",
            )
