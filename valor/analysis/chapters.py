"""What a report has of each experiment: its result, or the reason for which there is none.

A report is made of what is there. An experiment that failed, was broken off or lost a picture is told in its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from valor.analysis.errors import ResultError
from valor.analysis.results import FAILURE_FILE, FILE, Failure, Picture, Result

_PNG = b"\x89PNG\r\n\x1a\n"


class Listed(Protocol):
    """An experiment as the table of all names it."""

    @property
    def name(self) -> str:
        """Of its folder."""

    @property
    def title(self) -> str:
        """Of its chapter."""

    @property
    def reproduces(self) -> str:
        """Tables and figures of the thesis."""


@dataclass(frozen=True)
class Chapter:
    """One experiment of a report.

    Attributes:
        name: of the experiment.
        title: what it is about.
        reproduces: tables and figures of the thesis.
        folder: where its files are.
        result: what it found; None: nothing.
        absence: why there is no result, in a sentence; empty: there is.
        broken: what should be there and is not: the run failed, or a file cannot be used. Empty for an experiment that
            nobody ran.
    """

    name: str
    title: str
    reproduces: str
    folder: Path
    result: Result | None
    absence: str = ""
    broken: tuple[str, ...] = ()

    def fault(self, picture: Picture) -> str:
        """Why a picture cannot be shown; empty: it can."""
        file = self.folder / picture.file
        try:
            with open(file, "rb") as opened:
                return "" if opened.read(len(_PNG)) == _PNG else f"{file}: not a picture"
        except OSError as error:
            return f"{file}: {error.strerror}; the result names it as a picture"


def collect(folder: Path, experiments: Sequence[Listed]) -> list[Chapter]:
    """A chapter for every experiment, from the folders of their names in a folder.

    Raises:
        ResultError: none of them was ever run.
    """
    chapters = [_chapter(each, folder / each.name) for each in experiments]
    if not any(chapter.result or chapter.broken for chapter in chapters):
        raise ResultError(f"{folder}: no results of experiments ({', '.join(each.name for each in experiments)})")
    return chapters


def command_for_all(chapters: Sequence[Chapter]) -> str:
    """The one command that makes all results again; empty: they were made with different options."""
    made = [chapter.result for chapter in chapters if chapter.result]
    commands = {result.command.replace(f"experiment {result.experiment}", "experiment all", 1) for result in made}
    return commands.pop() if len(commands) == 1 else ""


def _chapter(listed: Listed, folder: Path) -> Chapter:
    def absent(why: str, *broken: str) -> Chapter:
        return Chapter(listed.name, listed.title, listed.reproduces, folder, None, why, broken)

    try:
        if (folder / FAILURE_FILE).exists():
            failure = Failure.load(folder)
            why = f"{failure.command}, begun {failure.started}, failed: {failure.reason}"
            return absent(why, f"{listed.name} failed: {failure.reason}")
        if not folder.is_dir():
            return absent(f"Not run: there is no folder {folder}.")
        if not (folder / FILE).exists():
            return absent(f"Not finished: {folder} has no {FILE}.", f"{listed.name}: not finished")
        result = Result.load(folder)
    except ResultError as error:
        return absent(f"Its result cannot be read: {error}", f"{listed.name}: {error}")
    chapter = Chapter(listed.name, result.title, result.reproduces, folder, result)
    faults = tuple(fault for picture in result.pictures if (fault := chapter.fault(picture)))
    return Chapter(listed.name, result.title, result.reproduces, folder, result, broken=faults)
