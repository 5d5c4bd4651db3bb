"""What is wrong with a robot's folder, found before anything starts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from valor.robot.description import RobotDescription
from valor.whole_body.tuning_checks import margins_fit_the_soles

if TYPE_CHECKING:
    from valor.robot.soundness import Findings

_TOLD = 6  # differences of the sides


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


def notes(findings: Findings) -> list[str]:
    """What is no fault, and worth knowing: what nothing drives, and how far the sides are from mirror images."""
    from valor.robot.checks import Stance
    from valor.robot.symmetry import asymmetries

    if findings.robot is None or findings.faults:
        return []
    differing = list(asymmetries(Stance(findings.robot)))
    more = [f"and {len(differing) - _TOLD} more that differ"] if len(differing) > _TOLD else []
    return [*_passive(findings.robot), *differing[:_TOLD], *more]


def _passive(robot: RobotDescription) -> list[str]:
    kinds = {"simulated, fixed for controllers": True, "welded": False}
    named = {kind: [n for n, each in robot.tables.passive.items() if each.simulated is m] for kind, m in kinds.items()}
    return [f"nothing drives, {kind}: {', '.join(names)}" for kind, names in named.items() if names]
