"""What is wrong with a robot's folder, found before anything starts."""

from __future__ import annotations

from pathlib import Path

from valor.robot.description import RobotDescription
from valor.whole_body.tuning_tables import Tuning


def require_sound(folder: Path, control_rate: float | None = None) -> RobotDescription:
    """Read a robot's folder and check all of it.

    Raises:
        ConfigurationError: what is wrong, with file, line and key.
    """
    from valor.robot import checks, get_up_table  # with MuJoCo: a fifth of a second

    robot = RobotDescription.load(folder, control_rate)
    robot.read(Tuning)
    checks.require_sound(robot)
    get_up_table.load(robot)
    return robot
