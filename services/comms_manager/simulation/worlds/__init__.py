"""The worlds to simulate in: one MJCF file each, known by its name. The robot starts at the origin, facing x.

Geoms that the robot touches have ``contype`` 1 (see the defaults of a robot's ``model.xml``).
"""

from __future__ import annotations

from pathlib import Path

import mujoco

from valor_common.errors import ConfigurationError

FOLDER = Path(__file__).parent


def known() -> list[str]:
    """Names of the worlds."""
    return sorted(file.stem for file in FOLDER.glob("*.xml"))


def load(name: str) -> mujoco.MjSpec:
    """A world's spec.

    Raises:
        ConfigurationError: there is no such world.
    """
    if name not in known():
        raise ConfigurationError(f"world {name!r}: expected one of {', '.join(known())}")
    return mujoco.MjSpec.from_file(str(FOLDER / f"{name}.xml"))
