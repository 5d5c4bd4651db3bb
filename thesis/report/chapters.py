"""Chapters of a report: for each experiment its result, or the reason for its absence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from PIL import Image

from thesis.errors import ResultError
from thesis.report.results import FAILURE_FILE, FILE, Failure, Result


class Listed(Protocol):
    """An experiment as the table of all experiments names it."""

    @property
    def name(self) -> str:
        """Name of its folder."""

    @property
    def title(self) -> str:
        """Title of its chapter."""

    @property
    def reproduces(self) -> str:
        """Tables and figures of the thesis."""


@dataclass(frozen=True)
class Chapter:
    """One experiment of a report.

    Attributes:
        name: of the experiment.
        title: of the chapter.
        reproduces: tables and figures of the thesis.
        folder: where its files are.
        result: None if there is none.
        absence: why there is no result, in a sentence; empty if there is one.
        faults: by picture file, why it cannot be shown.
        broken: faults and failures. Empty for an experiment that was not run.
    """

    name: str
    title: str
    reproduces: str
    folder: Path
    result: Result | None
    absence: str = ""
    faults: Mapping[str, str] = field(default_factory=dict)
    broken: tuple[str, ...] = ()


def collect(folder: Path, experiments: Sequence[Listed]) -> list[Chapter]:
    """One chapter per experiment, from the subfolder of its name.

    Raises:
        ResultError: no experiment was run.
    """
    chapters = [_chapter(each, folder / each.name) for each in experiments]
    if not any(chapter.result or chapter.broken for chapter in chapters):
        raise ResultError(f"{folder}: no results of experiments ({', '.join(each.name for each in experiments)})")
    return chapters


def command_for_all(chapters: Sequence[Chapter]) -> str:
    """The one command that repeats all results; empty if their options differ."""
    made = [chapter.result for chapter in chapters if chapter.result]
    commands = {result.command.replace(f"experiment {result.experiment}", "experiment all", 1) for result in made}
    return commands.pop() if len(commands) == 1 else ""


def _chapter(listed: Listed, folder: Path) -> Chapter:
    def absent(why: str, *broken: str) -> Chapter:
        return Chapter(listed.name, listed.title, listed.reproduces, folder, None, why, {}, broken)

    try:
        if (folder / FAILURE_FILE).exists():
            failure = Failure.load(folder / FAILURE_FILE)
            why = f"{failure.command}, started {failure.started}, failed: {failure.reason}"
            return absent(why, f"{listed.name} failed: {failure.reason}")
        if not folder.is_dir():
            return absent(f"Not run: there is no folder {folder}.")
        if not (folder / FILE).exists():
            return absent(f"Not finished: {folder} has no {FILE}.", f"{listed.name}: not finished")
        result = Result.load(folder / FILE)
    except ResultError as error:
        return absent(f"Its result cannot be read: {error}", f"{listed.name}: {error}")
    faults = {each.file: fault for each in result.pictures if (fault := _fault(folder / each.file))}
    return Chapter(
        listed.name, result.title, result.reproduces, folder, result, "", faults, tuple(faults.values())
    )  # fmt: skip


def _fault(picture: Path) -> str:
    """Why a picture cannot be shown; empty if it can."""
    try:
        with Image.open(picture) as opened:
            opened.verify()
    except (OSError, SyntaxError) as error:  # PIL raises both for a malformed file
        return f"{picture}: {getattr(error, 'strerror', None) or 'not a picture'}; the result names it as a picture"
    return ""
