"""Controllers that robot.yaml names: policies in the robot's folder, and those of installed packages."""

from collections.abc import Iterator
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from valor.common.table import TableError
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import REMOTE, WHOLE_BODY

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
    """Check that each controller in robot.yaml is built in, installed or a policy, and that a client chooses remote."""
    for state, names in robot.tables.controllers.names().items():
        if names[0] == REMOTE:
            yield TableError(
                ("controllers", state),
                f"{REMOTE} is the first, which is used without a request; expected another, as {WHOLE_BODY}, before it",
            )
    known = installed()
    for name in others(robot):
        if name != REMOTE and name not in known and not policy_file(robot, name).is_file():
            there = sorted(each.stem for each in policy_file(robot, name).parent.glob("*.onnx"))
            yield TableError(
                ("controllers",),
                f"no controller {name!r}; expected {WHOLE_BODY}, {REMOTE}, an installed one "
                f"({', '.join(known) or 'none is'}), or a policy of the robot ({', '.join(there) or 'it has none'}); "
                "`valorctl policy add FILE` adds one",
            )
