"""What is wrong with a robot's folder, found before anything starts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from valor.robot.description import RobotDescription
from valor.whole_body.tuning_checks import margins_fit_the_soles

if TYPE_CHECKING:
    from valor.robot.soundness import Findings


def examine(folder: Path, control_rate: float | None = None) -> Findings:
    """All faults of a robot's folder.

    Args:
        folder: of the robot.
        control_rate: instead of robot.yaml's [Hz].
    """
    from valor.robot import soundness  # with MuJoCo: a fifth of a second

    return soundness.examine(folder, control_rate, beyond=(margins_fit_the_soles,))


def require_sound(folder: Path, control_rate: float | None = None) -> RobotDescription:
    """A robot without faults.

    Raises:
        ConfigurationError: a line for each fault, with file, line and key.
    """
    return examine(folder, control_rate).require_none()
