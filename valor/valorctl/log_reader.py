"""The logs of an instance's processes, merged by time: what they printed last, and what comes."""

from __future__ import annotations

import itertools
import os
import re
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Self, TextIO

from valor.common.errors import ConfigurationError, ValorError, expected, require_one_of
from valor.common.instance import Instance
from valor.common.processes import BY_NAME

SUPERVISOR = "supervisord"
SERVICES = (*BY_NAME, SUPERVISOR)
LEVELS = ("debug", "info", "warning", "error", "critical")

_POLL_PERIOD = 0.1  # [s]
# As Python's logging and supervisord begin a line; what does not begin so belongs to the line above.
_LINE = re.compile(r"(?P<time>\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)[,.](?P<ms>\d{3}) (?P<level>[A-Z]+):? (?P<text>.*)")
_LEVEL = {"WARN": "warning", "CRIT": "critical", "FATAL": "critical", "TRAC": "debug", "BLAT": "debug"}
_AGO = re.compile(r"(\d+(?:\.\d+)?) ?(s|min|h|d)")
_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_MOMENTS = ("%Y-%m-%d %H:%M:%S", "%Y-%m-%d %H:%M", "%Y-%m-%d", "%H:%M:%S", "%H:%M")


@dataclass(frozen=True)
class Line:
    """One line of a log.

    Attributes:
        when: it was printed, by the computer's clock; of a line without a time, that of the one above.
        level: one of ``LEVELS``.
        text: without time and level.
    """

    when: datetime
    level: str
    service: str
    text: str
    begins: bool  # it has a time of its own


def moment(text: str, now: datetime) -> datetime:
    """When ``--since`` means: so long ago (``30s``, ``5min``, ``2h``), or a time of today or of a date.

    Raises:
        ConfigurationError: it is neither.
    """
    if ago := _AGO.fullmatch(text):
        return now - timedelta(seconds=float(ago[1]) * _SECONDS[ago[2]])
    for form in _MOMENTS:
        try:
            found = datetime.strptime(text, form)
        except ValueError:
            continue
        return found if "%Y" in form else datetime.combine(now.date(), found.time())
    raise ConfigurationError(f"--since {text!r}: expected 30s, 5min, 2h, 14:05, 14:05:30 or 2026-01-31 14:05")


class LogReader:
    """Reads one log, or all. A context manager."""

    def __init__(
        self,
        instance: Instance,
        name: str | None,
        since: datetime | None = None,
        level: str = "",
        lines: int | None = None,
    ) -> None:
        """Open the logs.

        Args:
            instance: up or not.
            name: of a service; None: all.
            since: leave out what is older.
            level: leave out what is less grave; empty: nothing.
            lines: how many of the last are wanted; None: all. More may be taken.

        Raises:
            ValorError: unknown process or level, or no log of it; lists the known.
        """
        if name is not None:
            require_one_of("service", name, SERVICES)
        if level and level not in LEVELS:
            raise ConfigurationError(f"--level {expected(level, LEVELS)}")
        paths = {each: instance.logs / f"{each}.log" for each in ([name] if name else SERVICES)}
        self._logs = {each: _Log(each, path) for each, path in paths.items() if path.exists()}
        if not self._logs:
            of = f"of {name} " if name else ""
            raise ValorError(f"instance {instance.name!r}: no log {of}in {instance.logs}")
        self._since, self._lines = since, lines
        self.problems: tuple[str, ...] = ()  # of computers that are gone: it reads files of this one
        self._begun = False
        self._gravest = frozenset(LEVELS[LEVELS.index(level) if level else 0 :])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        for log in self._logs.values():
            log.close()

    def take(self) -> list[Line]:
        """What has been printed and was not taken before, in the order of time."""
        logs = self._logs.values()
        if self._begun:
            found = [line for log in logs for line in log.take()]
        else:
            self._begun = True
            found = [line for log in logs for line in log.begin(self._enough)]
        return sorted(filter(self._wanted, found), key=lambda line: line.when)

    def wait(self) -> list[Line]:
        """Likewise; waits a moment if there is nothing."""
        lines = self.take()
        if not lines:
            time.sleep(_POLL_PERIOD)
        return lines

    def _enough(self, found: list[Line]) -> bool:
        """Whether nothing that is older than these is asked for."""
        timed = list(itertools.dropwhile(lambda line: not line.begins, found))  # what is before may be part of a line
        if self._since is not None and timed and timed[0].when < self._since:
            return True
        return self._lines is not None and sum(map(self._wanted, timed)) >= self._lines

    def _wanted(self, line: Line) -> bool:
        return line.level in self._gravest and (self._since is None or line.when >= self._since)


class _Log:
    """One file, also when it is begun anew, and those that supervisord moved out of its way when they were full."""

    def __init__(self, service: str, path: Path) -> None:
        self._service, self._path = service, path
        self._file = self._open()
        self._partial = ""
        self._forget()

    def _forget(self) -> None:
        # Of what is printed before anything has a time: the file itself is no older than that.
        self._when, self._level = datetime.fromtimestamp(os.fstat(self._file.fileno()).st_mtime), "info"
        self._any = False

    def _open(self) -> TextIO:
        return open(self._path, errors="replace")

    def close(self) -> None:
        self._file.close()

    def begin(self, enough: Callable[[list[Line]], bool]) -> list[Line]:
        """What is there to begin with, of the older files as much as it takes until it is enough."""
        older = self._older()
        text = self._file.read()
        while True:
            *texts, self._partial = text.split("\n")
            self._forget()
            lines = self._lines(texts)
            if not older or enough(lines):
                return lines
            text = older.pop().read_text(errors="replace") + text  # a line may stand in both

    def _older(self) -> list[Path]:
        """The newest last."""
        ours = os.fstat(self._file.fileno()).st_ino  # which may have been moved since it was opened
        found = [path for path in self._path.parent.glob(f"{self._path.name}.*") if path.suffix[1:].isdecimal()]
        found = [path for path in found if path.stat().st_ino != ours]
        return sorted(found, key=lambda path: int(path.suffix[1:]), reverse=True)

    def take(self) -> list[Line]:
        *texts, self._partial = (self._partial + self._file.read()).split("\n")
        if not texts and self._begun_anew():
            self._file.close()
            self._file, self._partial = self._open(), ""
        return self._lines(texts)

    def _lines(self, texts: Iterable[str]) -> list[Line]:
        early: list[str] = []
        lines: list[Line] = []
        for text in texts:
            if found := _LINE.match(text):
                self._when = datetime.fromisoformat(f"{found['time']}.{found['ms']}")
                self._level = _LEVEL.get(found["level"], found["level"].lower())
                self._any = True
                lines += [Line(self._when, "info", self._service, each, False) for each in early]
                early.clear()
                own = found["text"].removeprefix(f"{self._service}: ")
                lines.append(Line(self._when, self._level, self._service, own, True))
                continue
            if text.startswith("Traceback "):
                self._level = "error"
            if self._any:
                lines.append(Line(self._when, self._level, self._service, text, False))
            else:
                early.append(text)
        return lines + [Line(self._when, self._level, self._service, each, False) for each in early]

    def _begun_anew(self) -> bool:
        try:
            there = os.stat(self._path)
        except FileNotFoundError:
            return False
        ours = os.fstat(self._file.fileno())
        return there.st_ino != ours.st_ino or there.st_size < self._file.tell()
