"""The logs of an instance on several hosts, merged by time."""

from __future__ import annotations

import time
from collections import Counter
from datetime import datetime
from typing import Any, Self

from valor.common.errors import ValorError, require_one_of
from valor.common.instance import Instance
from valor.valorctl.hosts.channel import HostError
from valor.valorctl.hosts.fleet import Fleet
from valor.valorctl.log_reader import LEVELS, SERVICES, Line, LogReader

Row = tuple[float, str, str, str, bool]  # when [s, the host's wall clock], level, service, text, begins
PERIOD = 1.0  # between two looks [s]


def lines_here(
    instance: Instance, service: str | None, since: float | None, level: str, lines: int | None
) -> list[Row]:
    """What the processes of this computer have printed; none, if they have no log here.

    Raises:
        ValorError: unknown service or level.
    """
    begin = None if since is None else datetime.fromtimestamp(since)
    if service is not None and not (instance.logs / f"{service}.log").exists():
        return []
    with LogReader(instance, service, begin, level, lines) as reader:
        found = reader.take()
    if lines is not None:
        found = found[max(0, len(found) - lines) :]
    return [(line.when.timestamp(), line.level, line.service, line.text, line.begins) for line in found]


class HostsLogs:
    """Reads one log, or all, of all hosts. A context manager, as ``LogReader``."""

    def __init__(
        self, instance: Instance, service: str | None, since: datetime | None, level: str, lines: int | None
    ) -> None:
        """As ``LogReader``.

        Raises:
            ConfigurationError: this computer has not joined the deployment; unknown service or level.
        """
        if service is not None:
            require_one_of("service", service, SERVICES)
        if level:
            require_one_of("--level", level, LEVELS)
        settings = instance.settings()
        self._fleet = Fleet(instance, settings)
        self._wanted: dict[str, Any] = {"service": service, "level": level}
        self._since, self._lines = None if since is None else since.timestamp(), lines
        self._newest: dict[str, float] = {}
        self._seen: dict[str, Counter[Row]] = {}
        self.problems: tuple[str, ...] = ()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._fleet.close()

    def take(self) -> list[Line]:
        """What has been printed and was not taken before, in the order of time; ``problems``: of hosts that are gone.

        Raises:
            ValorError: no host has such a log.
        """
        if not self._newest:
            answers = self._fleet.ask("log_lines", 20.0, since=self._since, lines=self._lines, **self._wanted)
        else:
            since = min(self._newest.values())
            answers = self._fleet.ask("log_lines", 20.0, since=since, lines=None, **self._wanted)
        gone = {name: each for name, each in answers.items() if isinstance(each, HostError)}
        self.problems = tuple(self._fleet.told(name, each) for name, each in gone.items())
        rows = [
            row for name, each in answers.items() if not isinstance(each, HostError) for row in self._new(name, each)
        ]
        if not rows and not self._newest and self.problems:
            raise ValorError("\n".join(self.problems))
        lines = [Line(datetime.fromtimestamp(row[0]), *row[1:]) for row in rows]
        return sorted(lines, key=lambda line: line.when)

    def wait(self) -> list[Line]:
        """Likewise; waits a moment before."""
        time.sleep(PERIOD)
        return self.take()

    def _new(self, host: str, rows: list[Any]) -> list[Row]:
        """Those that were not there at the last look."""
        newest, seen = self._newest.get(host, 0.0), Counter(self._seen.get(host, ()))
        found: list[Row] = []
        for each in rows:
            row: Row = tuple(each)
            if row[0] > newest or (row[0] == newest and seen[row] == 0):
                found.append(row)
            elif row[0] == newest:
                seen[row] -= 1
        self._newest[host] = max([newest, *(row[0] for row in found)])
        self._seen[host] = Counter(tuple(row) for row in rows if row[0] == self._newest[host])
        return found
