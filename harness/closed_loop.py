"""A robot of ours under control in one process (``valor.self_test``), with values of its tables replaced."""

from __future__ import annotations

from collections.abc import Mapping

from harness.places import ROBOTS
from valor.common.table import checked, plain
from valor.robot.description import RobotDescription
from valor.robot.tables import RobotTables
from valor.self_test.closed_loop import ClosedLoop

__all__ = ["ClosedLoop", "load_robot"]


def load_robot(name: str = "escher", **tables: Mapping[str, object] | float | str) -> RobotDescription:
    """A robot, with values of some of its tables replaced: ``whole_body={"dcm_gain": 3.0}``, ``control_rate=1000``."""
    robot = RobotDescription.load(ROBOTS / name)
    if not tables:
        return robot
    content = plain(robot.tables)
    for table, values in tables.items():
        if isinstance(values, Mapping):
            content[table].update(values)
        else:
            content[table] = values
    return RobotDescription(robot.folder, checked(RobotTables, content))
