"""What an experiment found, as one file beside its figures: the report is made of these alone."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import ClassVar, Self

import msgspec
import psutil

from valor.analysis import json_file
from valor.analysis.errors import ResultError

FILE = "result.json"
FAILURE_FILE = "failure.json"
LONGEST_NUMBER = 16  # characters of a number, its unit and sign


class Measure(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One number, beside the thesis'."""

    name: str
    value: float | None  # None: could not be measured; the note says why
    unit: str
    thesis: str = ""  # as printed there; empty: not there
    note: str = ""  # what is the same, what differs and why


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Rows of text, the first column naming each."""

    title: str
    columns: list[str]
    rows: list[list[str]]

    def is_text(self, column: int) -> bool:
        """Whether a column holds text, to be read from the left; else numbers, to be compared by their ends."""
        return column == 0 or any(len(row[column]) > LONGEST_NUMBER for row in self.rows)


class Picture(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A figure, in a file beside the result."""

    file: str
    caption: str
    reproduces: str = ""  # the thesis' figure


class _Stored(msgspec.Struct, frozen=True):
    """What an experiment leaves in its folder as a file."""

    FILE: ClassVar[str]
    WHAT: ClassVar[str]

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read the one in a folder.

        Raises:
            ResultError: there is none, or it is not one; names the file.
        """
        return json_file.load(folder / cls.FILE, cls, ResultError, f"the {cls.WHAT} of an experiment")

    def save(self, folder: Path) -> Path:
        """Write it into a folder; returns the file."""
        return json_file.save(self, folder / self.FILE)


class Result(_Stored, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One run of one experiment."""

    FILE = FILE
    WHAT = "result"

    experiment: str
    title: str
    reproduces: str  # tables and figures of the thesis
    command: str  # that makes it again
    started: str  # ISO 8601
    quick: bool  # a short form: it shows that everything works, its numbers say little
    settings: dict[str, str]  # robot, profile, actuators, seed, …
    host: dict[str, str]
    text: str  # what was done, in a few sentences
    measures: list[Measure]
    tables: list[Table] = []
    pictures: list[Picture] = []
    files: list[str] = []  # CSV, bag
    seconds: float = 0.0  # that it took


class Failure(_Stored, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A run of an experiment that came to no result."""

    FILE = FAILURE_FILE
    WHAT = "failure"

    experiment: str
    command: str  # that makes it again
    started: str  # ISO 8601
    reason: str  # in one line
    details: str = ""  # where in the program, if nobody foresaw it


def host_facts() -> dict[str, str]:
    """The computer that an experiment runs on, and how busy it is."""
    model = next(
        (line.partition(":")[2].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")),
        platform.machine(),
    )
    load = os.getloadavg()
    return {
        "processor": model,
        "cores": str(os.cpu_count()),
        "memory": f"{psutil.virtual_memory().total / 2**30:.0f} GiB",
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "load": f"{load[0]:.1f} before it began (mean of one minute)",
    }


def _lines(file: str) -> list[str]:
    try:
        return Path(file).read_text().splitlines()
    except OSError:
        return []
