"""Logs of an instance's processes, merged by time: the last lines, and new lines."""

import os
import re
import time
from collections.abc import Iterable
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
# Start of a line by Python's logging or by supervisord; other lines continue the line above.
_LINE = re.compile(r"(?P<time>\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)[,.](?P<ms>\d{3}) (?P<level>[A-Z]+):? (?P<text>.*)")
_LEVEL = {"WARN": "warning", "CRIT": "critical", "FATAL": "critical", "TRAC": "debug", "BLAT": "debug"}
_AGO = re.compile(r"(\d+(?:\.\d+)?) ?(s|min|h|d)")
_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_MOMENTS = ("%Y-%m-%d %H:%M:%S", "%Y-%m-%d %H:%M", "%Y-%m-%d", "%H:%M:%S", "%H:%M")


@dataclass(frozen=True)
class LogLine:
    """One line of a log."""

    when: datetime  # time by the computer's clock; without a time of its own, that of the line above
    level: str  # one of ``LEVELS``
    service: str  # process
    text: str  # without time and level
    begins: bool  # the line has a time of its own


def moment(text: str, now: datetime) -> datetime:
    """Parse ``--since``: an age (``30s``, ``5min``, ``2h``) or a time; raises ``ConfigurationError``."""
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
    """Reader of one log, or of all. A context manager."""

    problems: tuple[str, ...] = ()  # of unreachable hosts, in ``HostsLogs``

    def __init__(
        self,
        instance: Instance,
        name: str | None,
        since: datetime | None = None,
        level: str = "",
        lines: int | None = None,
    ) -> None:
        """Open the logs of a process, or of all; ``lines``: required last ones, of which ``take`` may return more.

        Renamed full files are read back to ``since``. Raises ``ValorError``: no such process, level or log.
        """
        if name is not None:
            require_one_of("service", name, SERVICES)
        if level and level not in LEVELS:
            raise ConfigurationError(f"--level {expected(level, LEVELS)}")
        paths = {each: instance.logs / f"{each}.log" for each in ([name] if name else SERVICES)}
        back_to = since or (datetime.min if lines is None else datetime.max)
        self._logs = [_Log(each, path, back_to) for each, path in paths.items() if path.exists()]
        if not self._logs:
            of = f"of {name} " if name else ""
            raise ValorError(f"instance {instance.name!r}: no log {of}in {instance.logs}")
        self._since = since
        self._levels = frozenset(LEVELS[LEVELS.index(level) if level else 0 :])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        for log in self._logs:
            log.close()

    def take(self) -> list[LogLine]:
        """The lines since the previous call, in the order of time."""
        found = [line for log in self._logs for line in log.take() if line.level in self._levels]
        wanted = [line for line in found if self._since is None or line.when >= self._since]
        return sorted(wanted, key=lambda line: line.when)

    def wait(self) -> list[LogLine]:
        """The lines since the previous call; without any, wait for the poll period."""
        lines = self.take()
        if not lines:
            time.sleep(_POLL_PERIOD)
        return lines


class _Log:
    """One file, also if it is replaced, after the older files to which supervisord renamed full ones."""

    def __init__(self, service: str, path: Path, back_to: datetime) -> None:
        self._service, self._path = service, path
        self._file = self._open()
        current = os.fstat(self._file.fileno())  # may have been renamed since it was opened
        older = [file for file in path.parent.glob(f"{path.name}.*") if file.suffix[1:].isdecimal()]
        older = [file for file in older if file.stat().st_ino != current.st_ino]
        older = [file for file in older if datetime.fromtimestamp(file.stat().st_mtime) >= back_to]
        older.sort(key=lambda file: int(file.suffix[1:]), reverse=True)
        self._partial = "".join(file.read_text(errors="replace") for file in older)  # a line may continue in the next
        # Time of lines before the first with a time: the last modification of the file.
        self._when, self._level = datetime.fromtimestamp(current.st_mtime), "info"
        self._any = False

    def _open(self) -> TextIO:
        return open(self._path, errors="replace")

    def close(self) -> None:
        self._file.close()

    def take(self) -> list[LogLine]:
        *texts, self._partial = (self._partial + self._file.read()).split("\n")
        if not texts and self._replaced():
            self._file.close()
            self._file, self._partial = self._open(), ""
        return self._lines(texts)

    def _lines(self, texts: Iterable[str]) -> list[LogLine]:
        early: list[str] = []
        lines: list[LogLine] = []
        for text in texts:
            if found := _LINE.match(text):
                self._when = datetime.fromisoformat(f"{found['time']}.{found['ms']}")
                self._level = _LEVEL.get(found["level"], found["level"].lower())
                self._any = True
                lines += [LogLine(self._when, "info", self._service, each, False) for each in early]
                early.clear()
                own = found["text"].removeprefix(f"{self._service}: ")
                lines.append(LogLine(self._when, self._level, self._service, own, True))
                continue
            if text.startswith("Traceback "):
                self._level = "error"
            if self._any:
                lines.append(LogLine(self._when, self._level, self._service, text, False))
            else:
                early.append(text)
        return lines + [LogLine(self._when, self._level, self._service, each, False) for each in early]

    def _replaced(self) -> bool:
        try:
            found = os.stat(self._path)
        except FileNotFoundError:
            return False
        current = os.fstat(self._file.fileno())
        return found.st_ino != current.st_ino or found.st_size < self._file.tell()
