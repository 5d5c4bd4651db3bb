"""Result of an experiment: one file beside its figures. The report is made from these files only."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import msgspec
import psutil

from thesis.stored import Stored

FILE = "result.json"
FAILURE_FILE = "failure.json"
LONGEST_NUMBER = 16  # characters of a number with unit and sign


class Measure(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One number, with the thesis' number for comparison."""

    name: str
    value: float | None  # None: could not be measured; the note states the reason
    unit: str
    thesis: str = ""  # as printed there; empty if the thesis has none
    note: str = ""  # what is the same, what differs and why


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Rows of text; the first column names each row."""

    title: str
    columns: list[str]
    rows: list[list[str]]

    def is_text(self, column: int) -> bool:
        """Return whether a column holds text, aligned left, rather than numbers, aligned right."""
        return column == 0 or any(len(row[column]) > LONGEST_NUMBER for row in self.rows)


class Picture(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A figure, in a file beside the result."""

    file: str
    caption: str
    reproduces: str = ""  # the thesis' figure


class Result(Stored, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One run of one experiment."""

    experiment: str
    title: str
    reproduces: str  # tables and figures of the thesis
    command: str  # that repeats it
    started: str  # ISO 8601
    quick: bool  # short form: a functional check, its numbers carry little weight
    settings: dict[str, str]  # robot, profile, actuators, seed, …
    host: dict[str, str]
    text: str  # what was done, in a few sentences
    measures: list[Measure]
    tables: list[Table] = []
    pictures: list[Picture] = []
    files: list[str] = []  # CSV, bag
    seconds: float = 0.0  # duration


class Failure(Stored, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A run of an experiment that ended without a result."""

    experiment: str
    command: str  # that repeats it
    started: str  # ISO 8601
    reason: str  # in one line
    details: str = ""  # traceback of an unexpected error


def host_facts() -> dict[str, str]:
    """The computer that an experiment runs on, and its load."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return {
        "processor": models[0] if models else platform.machine(),
        "cores": str(os.cpu_count()),
        "memory": f"{psutil.virtual_memory().total / 2**30:.0f} GiB",
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "load": f"{os.getloadavg()[0]:.1f} before it began (mean of one minute)",
    }
