"""Where the things are that are not code: robots, profiles, examples.

They lie at the root of a checkout, and under ``data`` beside this module once installed from a wheel.
"""

from __future__ import annotations

from pathlib import Path

from valor.common.errors import ConfigurationError, expected

_PACKAGE = Path(__file__).resolve().parent
_INSTALLED = _PACKAGE / "data"
IN_CHECKOUT = not _INSTALLED.is_dir()  # else installed from a wheel
REPAIR = "run `make setup`" if IN_CHECKOUT else "`pip check` says what is missing"  # where a package is not there
_ROOT = _PACKAGE.parents[1] if IN_CHECKOUT else _INSTALLED


def robots() -> list[str]:
    """Names of our robots."""
    return sorted(file.parent.name for file in (_ROOT / "robots").glob("*/robot.yaml"))


def deployments() -> list[str]:
    """Names of our deployments."""
    return sorted(file.stem for file in (_ROOT / "deploy" / "hosts").glob("*.yaml"))


def deployment_file(name: str) -> Path:
    """The file of one of our deployments, by its name."""
    return _ROOT / "deploy" / "hosts" / f"{name}.yaml"


def profiles() -> list[str]:
    """Names of our profiles."""
    return sorted(file.stem for file in (_ROOT / "deploy").glob("*.yaml"))


def plans() -> list[str]:
    """Names of our footstep plans."""
    return sorted(file.stem for file in (_ROOT / "examples" / "plans").glob("*.yaml"))


def robot_folder(robot: str) -> Path:
    """The folder of a robot: one of ours by name, or any folder with a ``robot.yaml``.

    Raises:
        ConfigurationError: no such robot; lists those known.
    """
    known = robots()
    if robot in known:
        return _ROOT / "robots" / robot
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
        return _ROOT / "deploy" / f"{profile}.yaml"
    file = Path(profile).expanduser()
    if file.suffix == ".yaml" and file.is_file():
        return file.resolve()
    raise ConfigurationError(f"profile {expected(profile, known, 'a .yaml file, or ')}")


def middleware_profile() -> Path:
    """Fast DDS' configuration for an instance that lives on one computer."""
    return _ROOT / "deploy" / "fastdds.xml"


def example_file(name: str) -> Path:
    """A file of ``examples``.

    Raises:
        ConfigurationError: no such file here.
    """
    file = _ROOT / "examples" / name
    if not file.is_file():
        raise ConfigurationError(f"{file}: not found; the installation is incomplete")
    return file


def plan_file(plan: str) -> Path:
    """The file of a footstep plan: one of ``examples/plans`` by name, or any other by its path.

    Raises:
        ConfigurationError: no such plan; lists those known.
    """
    known = plans()
    if plan in known:
        return _ROOT / "examples" / "plans" / f"{plan}.yaml"
    file = Path(plan).expanduser()
    if file.is_file():
        return file
    raise ConfigurationError(f"plan {expected(plan, known, 'a file, or ')}")
