"""The report as Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from thesis.report.chapters import Chapter, command_for_all
from thesis.report.results import Measure, Picture, Result, Table

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
"""Names of the ten measures at the beginning of the report."""
TITLE = "Chapter 5, measured again"
INTRODUCTION = (
    "The numerical results of the thesis from which this system was built, repeated on it: each number beside the one "
    "printed there, and why they differ."
)
SHORT = "A short run: it shows that everything works; its numbers say little."


def markdown(chapters: Sequence[Chapter]) -> str:
    """The whole report; pictures are files beside it, named by ``picture_name``."""
    command = command_for_all(chapters)
    parts = [f"# {TITLE}", INTRODUCTION, *([f"All of it again:\n\n    {command}"] if command else [])]
    results = [chapter.result for chapter in chapters if chapter.result]
    parts += [_summary(results)] if results else []
    for chapter in chapters:
        parts += _section(chapter)
    return "\n\n".join(part for part in parts if part) + "\n"


def picture_name(picture: Picture) -> str:
    """File name of a picture in the report's folder."""
    return Path(picture.file).with_suffix(".webp").name


def about(result: Result) -> str:
    """What a result reproduces, when and where it was measured, in one line."""
    settings = ", ".join(f"{key} {value}" for key, value in result.settings.items())
    host = ", ".join(f"{key} {value}" for key, value in result.host.items())
    took = f"{result.seconds / 60.0:.1f} min" if result.seconds else ""
    return " · ".join(part for part in (result.reproduces, result.started, took, settings, host) if part)


def _section(chapter: Chapter) -> list[str]:
    result = chapter.result
    head = f"## {chapter.title} ({chapter.reproduces})"
    if result is None:
        return [head, f"**{_text(chapter.absence)}**"]
    return [
        head,
        f"    {result.command}",
        _text(about(result)),
        f"**{SHORT}**" if result.quick else "",
        _text(result.text),
        _measures(result.measures),
        *(part for table in result.tables for part in _table(table)),
        *(part for picture in result.pictures for part in _picture(picture, chapter)),
    ]


def _summary(results: Iterable[Result]) -> str:
    found = {one.name: one for result in results for one in result.measures}
    rows = [(one.name, _number(one.value), one.unit, one.thesis or "–") for name in SUMMARY if (one := found.get(name))]
    return _grid(("in short", "here", "unit", "thesis"), rows, {1}) if rows else ""


def _measures(measures: Sequence[Measure]) -> str:
    rows = [(one.name, _number(one.value), one.unit, one.thesis or "–", one.note) for one in measures]
    return _grid(("", "here", "unit", "thesis", "what differs, and why"), rows, {1}) if rows else ""


def _table(table: Table) -> tuple[str, str]:
    numbers = {i for i in range(len(table.columns)) if not table.is_text(i)}
    return f"**{_text(table.title)}**", _grid(table.columns, table.rows, numbers)


def _grid(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: set[int]) -> str:
    """A table whose columns of numbers are aligned right."""
    marks = ["--:" if i in numbers else "---" for i in range(len(head))]
    return "\n".join(f"| {' | '.join(_text(cell) for cell in row)} |" for row in (head, marks, *rows))


def _picture(picture: Picture, chapter: Chapter) -> tuple[str, ...]:
    if fault := chapter.faults.get(picture.file):
        return (f"**{_text(picture.caption)} Not shown: {_text(fault)}.**",)
    caption = f"{picture.caption} Reproduces {picture.reproduces}." if picture.reproduces else picture.caption
    return f"![{_text(picture.caption)}]({picture_name(picture)})", f"*{_text(caption)}*"


def _number(value: float | None) -> str:
    """A measure's value, short."""
    return "–" if value is None else f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def _text(text: str) -> str:
    """Text with Markdown's special characters escaped."""
    for mark in ("|", "*", "<"):
        text = text.replace(mark, f"\\{mark}")
    return text
