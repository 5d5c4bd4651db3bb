"""The report as Markdown."""

from __future__ import annotations

import math
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
    "proprioception, hardware",
    "joint command by stamps, hardware",
    "joint command by correlation, hardware",
    "joint command to the first milliradian, hardware",
    "arm joint at rest from its goal, largest",
    "by the floating base, largest at a pose",
    "by the floating base where the CoM goes with the arm, largest at a pose",
    "real arms: from the goal at rest, largest",
    "real arms: share of the base in it",
)
"""Names of the measures at the beginning of the report."""
MESSAGES = ("Bifrost", "ROS 2 (rclpy, Fast DDS)")
PATHWAYS = ("mode change", "proprioception")  # the thesis' number of the joint command is by another method
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
    parts += [_summary(results), conclusion(results)] if results else []
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


def conclusion(results: Iterable[Result]) -> str:
    """What chapter 6.1 concludes of latencies, from ours; empty without both experiments on latencies."""
    found = {one.name: one for result in results for one in result.measures if one.value}
    messages = {name: found[f"{name}, mean"] for name in MESSAGES if f"{name}, mean" in found}
    pathways = [one for name, one in found.items() if name.partition(", ")[0] in PATHWAYS]
    if len(messages) < len(MESSAGES) or not pathways:
        return ""
    shortest = min(pathways, key=lambda one: one.value or 0.0)
    here, there = 1e3 * (shortest.value or 0.0), 1e3 * float(shortest.thesis)  # [µs]
    ours = [one.value or 0.0 for one in messages.values()]
    theirs = [float(one.thesis) for one in messages.values()]
    least, most = sorted(here / one for one in ours)
    return (
        "**Chapter 6.1** concludes that a message takes two orders of magnitude less than the shortest pathway "
        f"({there / max(theirs):.0f} and {there / min(theirs):.0f} times less), so that the choice between ROS and "
        f"Bifrost is negligible. Here it takes {least:.1f} and {most:.1f} times less than the shortest "
        f"({shortest.name}): {math.log10(least):.1f} and {math.log10(most):.1f} orders. The pathway became "
        f"{there / here:.0f} times shorter, messages {min(a / b for a, b in zip(ours, theirs, strict=True)):.1f} to "
        f"{max(a / b for a, b in zip(ours, theirs, strict=True)):.1f} times as long; the two ways of sending differ by "
        f"{100.0 * (max(ours) - min(ours)) / here:.0f} % of it."
    )


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
