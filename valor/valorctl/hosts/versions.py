"""What must be the same on all hosts before anything moves: the code, Python, the messages, the robot's files."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path

import msgspec

import bifrost
import valor.common
from valor.common.resources import robot_folder, robots

_NAMED = 3  # of several files that differ, so many


class Versions(msgspec.Struct, frozen=True):
    """Of one host; files by name, with the hash of what is in them."""

    python: str
    valor: str
    messages: str
    code: dict[str, str]
    robot: dict[str, str]


def versions(robot: str) -> Versions:
    """Of this computer.

    Args:
        robot: by name or folder, as on this computer.

    Raises:
        ConfigurationError: no such robot here.
    """
    packages = {"bifrost": Path(bifrost.__file__).parent, "valor": Path(valor.common.__file__).parents[1]}
    code = {f"{name}/{file}": digest for name, folder in packages.items() for file, digest in _hashes(folder, "*.py")}
    return Versions(
        python=".".join(platform.python_version_tuple()[:2]),
        valor=metadata.version("valor"),
        messages=metadata.version("valor-interfaces"),
        code=code,
        robot=dict(_hashes(robot_folder(robot), "*")),
    )


def known_as(robot: Path) -> str:
    """What a robot's folder is called on every host: by name, if it is one of ours."""
    return robot.name if robot.name in robots() and robot_folder(robot.name) == robot else str(robot)


def differences(ours: Versions, theirs: Versions) -> list[str]:
    """How another host's versions differ from ours, a phrase each; none: they are the same."""
    found = [
        f"{name} is {getattr(theirs, name)}, here {getattr(ours, name)}"
        for name in ("python", "valor", "messages")
        if getattr(theirs, name) != getattr(ours, name)
    ]
    for what in ("code", "robot"):
        if names := _differing(getattr(ours, what), getattr(theirs, what)):
            more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
            found.append(f"{what} differs in {', '.join(names[:_NAMED])}{more}")
    return found


def _differing(ours: Mapping[str, str], theirs: Mapping[str, str]) -> list[str]:
    return sorted(name for name in {*ours, *theirs} if ours.get(name) != theirs.get(name))


def _hashes(folder: Path, pattern: str) -> list[tuple[str, str]]:
    """Of a folder's files, but for compiled ones and data; follows the links to services' folders."""
    found = []
    for base in (folder, *(entry for entry in sorted(folder.iterdir()) if entry.is_symlink() and entry.is_dir())):
        for file in sorted(base.rglob(pattern)):
            name = file.relative_to(folder)
            if file.is_file() and not {"__pycache__", "data"}.intersection(name.parts):
                found.append((str(name), hashlib.blake2b(file.read_bytes(), digest_size=8).hexdigest()))
    return found
