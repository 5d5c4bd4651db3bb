"""Control modes by name, from ``control_modes.yaml``; ConfigurationError if the file cannot be read."""

from pathlib import Path
from typing import Any

import valor
from valor.common.behaviors import ControlMode
from valor.common.errors import ConfigurationError, expected

FILE = Path(valor.__file__).parent / "valor_ros_controller" / "control_modes.yaml"
PREPARING = ControlMode.STAND_PREP  # mode at startup, until the robot is in its posture


def initial() -> list[str]:
    """Control modes that ``up`` can request after startup."""
    return [name for name in modes() if name == PREPARING or name in modes()[PREPARING]["to"]]


def behaviors(mode: str) -> list[str]:
    """Behaviors to request in order, so that the VRC enters a mode. Raises ConfigurationError if none leads to it."""
    leading = {behavior for behavior, followed in reported().items() if followed == mode}
    motion: list[str] = modes().get(mode, {}).get("motion") or []
    if not leading.intersection(motion[-1:]):
        followed = [each for each in modes() if each in reported().values()]
        raise ConfigurationError(f"control mode {expected(mode, followed)}")
    return list(dict.fromkeys(motion))


def modes() -> dict[str, dict[str, Any]]:
    """Rows of the file by name."""
    return _table("modes")


def reported() -> dict[str, str]:
    """Behavior → mode that the VRC reports for it when no client requested a mode."""
    return _table("behaviors")


def _table(key: str) -> dict[str, Any]:
    from valor.common.document import Document

    table: dict[str, Any] = Document.load(FILE).content[key]  # type: ignore[index]
    return table
