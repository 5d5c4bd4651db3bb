"""Names of the control modes, from the VRC's own table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import valor

FILE = Path(valor.__file__).parent / "valor_ros_controller" / "control_modes.yaml"
PREPARING = "stand_prep"  # the mode that the robot comes up in, until it is in its posture


def names() -> list[str]:
    """All.

    Raises:
        ConfigurationError: the table cannot be read.
    """
    return list(_modes())


def initial() -> list[str]:
    """Those that the robot can be brought to when it has come up.

    Raises:
        ConfigurationError: the table cannot be read.
    """
    return [name for name in _modes() if name == PREPARING or name in _modes()[PREPARING]["to"]]


def _modes() -> dict[str, dict[str, Any]]:
    from valor.common.document import Document

    document = Document.load(FILE)
    try:
        modes: dict[str, dict[str, Any]] = document.content["modes"]  # type: ignore[index]
    except (KeyError, TypeError):
        raise document.error(["modes"], "expected, but missing") from None
    return modes
