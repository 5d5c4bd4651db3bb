"""Files that are not code (robots, profiles, examples): at a checkout's root, or in a wheel's ``data``."""

from pathlib import Path

from valor.common.errors import ConfigurationError, expected

_PACKAGE = Path(__file__).resolve().parent
IN_CHECKOUT = not (_PACKAGE / "data").is_dir()  # else installed from a wheel
REPAIR = "run `make setup`" if IN_CHECKOUT else "`pip check` lists what is missing"  # advice if a package is missing
_ROOT = _PACKAGE.parents[1] if IN_CHECKOUT else _PACKAGE / "data"
_FOLDERS = {"profile": "deploy", "deployment": "deploy/hosts", "plan": "examples/plans"}


def robots() -> list[str]:
    """Names of the robots."""
    return sorted(file.parent.name for file in (_ROOT / "robots").glob("*/robot.yaml"))


def names(kind: str) -> list[str]:
    """Names of all files of a kind: ``profile``, ``deployment`` or footstep ``plan``."""
    return sorted(file.stem for file in (_ROOT / _FOLDERS[kind]).glob("*.yaml"))


def file_of(kind: str, name: str) -> Path:
    """A profile, deployment or footstep plan by name, or by the path of a ``.yaml`` file. Raises ConfigurationError."""
    known = names(kind)
    if name in known:
        return _ROOT / _FOLDERS[kind] / f"{name}.yaml"
    file = Path(name).expanduser()
    if file.is_file() and file.suffix == ".yaml":
        return file.resolve()
    raise ConfigurationError(f"{kind} {expected(name, known, 'a .yaml file, or ')}")


def middleware_profile() -> Path:
    """Fast DDS' configuration of an instance on one computer."""
    return _ROOT / "deploy" / "fastdds.xml"


def robot_folder(robot: str) -> Path:
    """The folder of a robot, by name or by the path of a folder with a ``robot.yaml``. Raises ConfigurationError."""
    known = robots()
    if robot in known:
        return _ROOT / "robots" / robot
    folder = Path(robot).expanduser()
    if (folder / "robot.yaml").is_file():
        return folder.resolve()
    if folder.is_dir() and "/" in robot:
        raise ConfigurationError(f"robot {robot!r}: no robot.yaml in that folder")
    raise ConfigurationError(f"robot {expected(robot, known, 'a folder with robot.yaml, or ')}")


def policies(robot: str) -> list[Path]:
    """Trained policies of a robot, by ``robot_folder``'s names. Raises ConfigurationError."""
    return sorted((robot_folder(robot) / "policies").glob("*.onnx"))


def example_file(name: str) -> Path:
    """A file of ``examples``. Raises ConfigurationError if it is missing."""
    file = _ROOT / "examples" / name
    if not file.is_file():
        raise ConfigurationError(f"{file}: not found; the installation is incomplete")
    return file
