"""Where a bag comes from, by its recorder's metadata: of which robot, in which world."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from valor.bags.errors import BagError
from valor.bags.stored import StoredBag
from valor.common.resources import robot_folder, robots


def origin_of(bag: Path) -> dict[str, str]:
    """The recorder's metadata ``valor``; empty in a bag of another recorder.

    Raises:
        BagError: there is no bag there.
    """
    stored = StoredBag(bag)
    next(stored.messages(), None)  # it stands before all
    return stored.condition.origin


def robot_of(bag: Path, origin: Mapping[str, str]) -> Path:
    """The folder of the robot that a bag is of.

    Raises:
        BagError: it does not say, or that robot is not here.
    """
    name, folder = origin.get("robot"), origin.get("robot_folder")
    if folder and (Path(folder) / "robot.yaml").is_file():
        return Path(folder)
    if name in robots():
        return robot_folder(name)
    of = f"of robot {name!r}, which is not here" if name else "of a robot that it does not name"
    raise BagError(f"{bag}: {of}; expected --robot with one of {', '.join(robots())}, or its folder")
