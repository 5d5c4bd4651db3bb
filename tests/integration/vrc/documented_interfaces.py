"""The tables of ``docs/interfaces.md``, read."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from pathlib import Path

from valor.valor_ros_controller.controllers.configuration import TrackingControllerConfig, TrajectoryControllerConfig
from valor.valor_ros_controller.controllers.table import ControllersTable

DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "interfaces.md"


@dataclass(frozen=True)
class Row:
    """One name of a table."""

    name: str
    type: str  # package/Type, of an action's feedback package/action/Type_Feedback
    cells: dict[str, str]  # column → text


def section(title: str) -> str:
    """The text under a heading."""
    text = DOCUMENT.read_text()
    begin = text.index(f"\n## {title}\n")
    end = text.find("\n## ", begin + 4)
    return text[begin : end if end > 0 else len(text)]


def tables(title: str) -> list[list[dict[str, str]]]:
    """The tables under a heading: lists of rows, column → cell; columns without a heading are named by their place."""
    found: list[list[dict[str, str]]] = []
    for block in re.findall(r"(?:^\|.*\n)+", section(title) + "\n", re.MULTILINE):
        lines = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in block.splitlines()]
        columns = [name or str(place) for place, name in enumerate(lines[0])]
        found.append([dict(zip(columns, line, strict=True)) for line in lines[2:]])
    assert found, f"no table under {title!r}"
    return found


GOALS = list(ControllersTable.load().of_type(TrajectoryControllerConfig))
PLACEHOLDERS = {
    "<goal_controller>": GOALS,
    "<controller>": [*GOALS, *ControllersTable.load().of_type(TrackingControllerConfig)],
}


def names(cell: str) -> list[str]:
    """The ROS names in a cell: `{a,b}` and placeholders are written out, `…/x` is beside the name before."""
    result: list[str] = []
    for written in re.findall(r"`((?:/|…/)[^` ]*)`", cell):
        name = result[-1].rsplit("/", 1)[0] + written[1:] if written.startswith("…") else written
        parts = re.split(r"(\{[^}]*\}|<[a-z_]+>)", name)
        choices = [PLACEHOLDERS.get(part) or (part[1:-1].split(",") if part[:1] == "{" else [part]) for part in parts]
        result += ["".join(choice) for choice in itertools.product(*choices)]
    return result


def rows(title: str) -> list[list[Row]]:
    """The tables under a heading that name interfaces in their first column, one row a name."""
    made = []
    for table in tables(title):
        of_table: list[Row] = []
        for cells in table:
            words = re.findall(r"`([a-z0-9_]+/[A-Za-z0-9]+)`", cells["type"])
            kind = words[0] if words else (of_table[-1].type if "same" in cells["type"] else "")
            if cells["type"].endswith("feedback message"):
                kind = kind.replace("/", "/action/") + "_FeedbackMessage"
            of_table += [Row(name, kind, cells) for name in names(cells["name"])]
        made.append(of_table)
    return made
