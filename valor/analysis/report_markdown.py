"""The report as a folder for a repository: ``README.md`` with every number, and the figures beside it, as WebP."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from valor.analysis import report
from valor.analysis.chapters import Chapter, command_for_all
from valor.analysis.errors import ResultError
from valor.analysis.report import Grid
from valor.analysis.results import Picture, Table
from valor.common import whole_file

FILE = "README.md"


def write(chapters: Sequence[Chapter], folder: Path) -> Path:
    """Write the page and the figures; returns the page's path.

    Raises:
        ResultError: a file cannot be written.
    """
    command = command_for_all(chapters)
    parts = [f"# {report.TITLE}", report.INTRODUCTION, *([f"{report.ALL_AGAIN}\n\n    {command}"] if command else [])]
    summary = report.summary(chapter.result for chapter in chapters)
    parts += [_grid(summary)] if summary.rows else []
    for chapter in chapters:
        parts += _section(chapter)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for chapter in chapters:
            for picture in chapter.result.pictures if chapter.result else ():
                if not chapter.fault(picture):
                    _copy(chapter.folder / picture.file, folder / _name(picture))
        whole_file.write(folder / FILE, "\n\n".join(parts) + "\n")
    except OSError as error:
        raise ResultError(f"{error.filename}: {error.strerror}") from None
    return folder / FILE


def _section(chapter: Chapter) -> list[str]:
    result = chapter.result
    head = f"## {chapter.title} ({chapter.reproduces})"
    if result is None:
        return [head, f"**{_text(chapter.absence)}**"]
    return [
        head,
        f"    {result.command}",
        _text(report.about(result)),
        *([f"**{report.SHORT}**"] if result.quick else []),
        _text(result.text),
        *([_grid(report.grid_of_measures(result.measures))] if result.measures else []),
        *(part for table in result.tables for part in _table(table)),
        *(part for picture in result.pictures for part in _picture(picture, chapter)),
    ]


def _table(table: Table) -> tuple[str, str]:
    return f"**{_text(table.title)}**", _grid(report.grid_of_table(table))


def _grid(grid: Grid) -> str:
    marks = ["--:" if i in grid.right else "---" for i in range(len(grid.head))]
    return "\n".join(f"| {' | '.join(_text(cell) for cell in row)} |" for row in (grid.head, marks, *grid.rows))


def _picture(picture: Picture, chapter: Chapter) -> tuple[str, ...]:
    if fault := chapter.fault(picture):
        return (f"**{_text(report.not_shown(picture, fault))}**",)
    return f"![{_text(picture.caption)}]({_name(picture)})", f"*{_text(report.caption(picture))}*"


def _copy(picture: Path, to: Path) -> None:
    """Without loss, at half the size.

    Raises:
        ResultError: it is no picture.
        OSError: the copy cannot be written.
    """
    try:
        with Image.open(picture) as opened:
            drawn = opened.convert("RGB")
    except OSError as error:
        reason = error.strerror or "not a picture"
        raise ResultError(f"{picture}: {reason}; the result names it as a picture") from None
    drawn.save(to, lossless=True, method=6)


def _name(picture: Picture) -> str:
    return Path(picture.file).with_suffix(".webp").name


def _text(text: str) -> str:
    """What Markdown would take for its own is told as it is."""
    for mark in ("|", "*", "<"):
        text = text.replace(mark, f"\\{mark}")
    return text
