"""Where the things are that are not code: robots, profiles, examples.

They lie at the root of a checkout, and under ``valor/common/data`` once installed from a wheel.
"""

from __future__ import annotations

from pathlib import Path

from valor.common.errors import ConfigurationError, expected

_PACKAGE = Path(__file__).resolve().parent
_CHECKOUT = _PACKAGE.parents[1]


def _root() -> Path:
    """The folder that holds ``robots`` and ``deploy``."""
    return _CHECKOUT if (_CHECKOUT / "pyproject.toml").is_file() else _PACKAGE / "data"


def robots() -> list[str]:
    """Names of our robots."""
    return sorted(file.parent.name for file in (_root() / "robots").glob("*/robot.yaml"))


def profiles() -> list[str]:
    """Names of our profiles."""
    return sorted(file.stem for file in (_root() / "deploy").glob("*.yaml"))


def robot_folder(robot: str) -> Path:
    """The folder of a robot: one of ours by name, or any folder with a ``robot.yaml``.

    Raises:
        ConfigurationError: no such robot; lists those known.
    """
    known = robots()
    if robot in known:
        return _root() / "robots" / robot
    folder = Path(robot).expanduser()
    if (folder / "robot.yaml").is_file():
        return folder.resolve()
    if folder.is_dir() and "/" in robot:
        raise ConfigurationError(f"robot {robot!r}: no robot.yaml in that folder")
    raise ConfigurationError(f"robot {expected(robot, known, 'a folder with robot.yaml, or ')}")


def profile_file(profile: str) -> Path:
    """The file of a profile: one of ours by name, or any ``.yaml`` file by its path.

    Raises:
        ConfigurationError: no such profile; lists those known.
    """
    known = profiles()
    if profile in known:
        return _root() / "deploy" / f"{profile}.yaml"
    file = Path(profile).expanduser()
    if file.suffix == ".yaml" and file.is_file():
        return file.resolve()
    raise ConfigurationError(f"profile {expected(profile, known, 'a .yaml file, or ')}")


def middleware_profile() -> Path:
    """Fast DDS' configuration for an instance that lives on one computer."""
    return _root() / "deploy" / "fastdds.xml"


def example_file(name: str) -> Path:
    """A program of ``examples``, which come with a checkout only.

    Raises:
        ConfigurationError: no such file here.
    """
    file = _CHECKOUT / "examples" / name
    if not file.is_file():
        raise ConfigurationError(f"{file}: not found; the examples come with a checkout of the repository")
    return file
