"""What a report says, whatever it is written as: a page (``report_html``), paper (``report_pdf``), or a folder for a
repository (``report_markdown``). Those say how it looks.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from valor.analysis.results import Measure, Picture, Result, Table

SUMMARY = (
    "VRC processor, mean",
    "Motion System processor, mean",
    "Bifrost, mean",
    "ROS 2 (rclpy, Fast DDS), mean",
    "mode change, hardware",
    "joint command, hardware",
    "arm joint at rest from its goal, largest",
    "by the floating base, largest at a pose",
    "by the floating base where the CoM goes with the arm, largest at a pose",
    "real arms: from the goal at rest, largest",
)
"""The ten numbers that a report begins with."""
TITLE = "Chapter 5, measured again"
INTRODUCTION = (
    "The numerical results of the thesis from which this system was built, repeated on it: each number beside the one "
    "printed there, and why they differ."
)
SHORT = "A short run: it shows that everything works; its numbers say little."
ALL_AGAIN = "All of it again:"
AGAIN = "Made again by:"


@dataclass(frozen=True)
class Grid:
    """Cells of text.

    Attributes:
        head: names of the columns.
        rows: below it.
        right: columns of numbers, which are compared by their ends.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    right: frozenset[int]


def about(result: Result) -> str:
    """What a result is of, when and where it was measured, in a line."""
    settings = ", ".join(f"{key} {value}" for key, value in result.settings.items())
    host = ", ".join(f"{key} {value}" for key, value in result.host.items())
    took = f"{result.seconds / 60.0:.1f} min" if result.seconds else ""
    return " · ".join(part for part in (result.reproduces, result.started, took, settings, host) if part)


def grid_of_measures(measures: Sequence[Measure]) -> Grid:
    """An experiment's numbers, each beside the thesis'."""
    rows = [(one.name, _number(one.value), one.unit, one.thesis or "–", one.note) for one in measures]
    return Grid(("", "here", "unit", "thesis", "what differs, and why"), rows, frozenset({1}))


def grid_of_table(table: Table) -> Grid:
    """A table as it is written."""
    columns = range(len(table.columns))
    return Grid(table.columns, table.rows, frozenset(i for i in columns if not table.is_text(i)))


def summary(results: Iterable[Result | None]) -> Grid:
    """What a reader takes along who reads no further, as far as it was measured."""
    found = {one.name: one for result in results if result is not None for one in result.measures}
    rows = [(one.name, _number(one.value), one.unit, one.thesis or "–") for name in SUMMARY if (one := found.get(name))]
    return Grid(("in short", "here", "unit", "thesis"), rows, frozenset({1}))


def caption(picture: Picture) -> str:
    """What stands below a picture."""
    return f"{picture.caption} Reproduces {picture.reproduces}." if picture.reproduces else picture.caption


def not_shown(picture: Picture, fault: str) -> str:
    """What stands where a picture should be."""
    return f"{picture.caption} Not shown: {fault}."


def _number(value: float | None) -> str:
    """A measure's value, short."""
    return "–" if value is None else f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
