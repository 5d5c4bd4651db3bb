"""Names of the control modes, from the VRC's own table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import valor
from valor.common.behaviors import ControlMode
from valor.common.errors import ConfigurationError, expected

FILE = Path(valor.__file__).parent / "valor_ros_controller" / "control_modes.yaml"
PREPARING = ControlMode.STAND_PREP  # the mode that the robot comes up in, until it is in its posture


def names() -> list[str]:
    """All.

    Raises:
        ConfigurationError: the table cannot be read.
    """
    return list(modes())


def initial() -> list[str]:
    """Those that the robot can be brought to when it has come up.

    Raises:
        ConfigurationError: the table cannot be read.
    """
    return [name for name in modes() if name == PREPARING or name in modes()[PREPARING]["to"]]


def behaviors(mode: str) -> list[str]:
    """What to ask the Motion Manager for, one after the other, for the VRC to follow into a mode.

    Raises:
        ConfigurationError: the table cannot be read, or nothing that the Motion Manager does leads to the mode.
    """
    led = {behavior for behavior, followed in reported().items() if followed == mode}
    motion: list[str] = modes().get(mode, {}).get("motion") or []
    if not led.intersection(motion[-1:]):
        followed = [each for each in names() if each in reported().values()]
        raise ConfigurationError(f"control mode {expected(mode, followed)}")
    return list(dict.fromkeys(motion))


def modes() -> dict[str, dict[str, Any]]:
    """The table: by name, with the keys that its file explains.

    Raises:
        ConfigurationError: the table cannot be read.
    """
    return _table("modes")


def reported() -> dict[str, str]:
    """Behavior → the mode that the VRC reports it as, where nobody asked for one.

    Raises:
        ConfigurationError: the table cannot be read.
    """
    return _table("behaviors")


def _table(key: str) -> dict[str, Any]:
    from valor.common.document import Document

    document = Document.load(FILE)
    try:
        table: dict[str, Any] = document.content[key]  # type: ignore[index]
    except (KeyError, TypeError):
        raise document.error([key], "expected, but missing") from None
    return table
