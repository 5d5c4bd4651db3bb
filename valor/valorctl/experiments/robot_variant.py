"""A robot of ours with some numbers of its robot.yaml changed, as a folder of an experiment's own."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from valor.common.document import Document
from valor.common.resources import robot_folder


def make(robot: str, changes: Mapping[str, Mapping[str, Any]], folder: Path) -> Path:
    """Copy a robot and change its tables.

    Args:
        robot: a name of robots/, or a folder.
        changes: values by key, by table of robot.yaml.
        folder: of the copy; replaced if it is there.

    Returns:
        The folder, which ``valorctl up --robot`` takes.
    """
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(robot_folder(robot), folder)
    file = folder / "robot.yaml"
    tables: Any = Document.load(file).content
    for table, values in changes.items():
        tables.setdefault(table, {}).update(values)
    file.write_text(yaml.safe_dump(tables, sort_keys=False))
    return folder
