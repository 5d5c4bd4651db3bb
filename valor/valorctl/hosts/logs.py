"""The logs of an instance on several hosts, merged by time."""

import contextlib
import time
from collections.abc import Iterator
from datetime import datetime
from io import FileIO
from subprocess import Popen
from typing import Self

import msgspec

from valor.common.errors import ValorError, require_one_of
from valor.common.instance import Host, Instance
from valor.valorctl.hosts.remote import HostError, Order, Reply, carrier, ended, send
from valor.valorctl.status.log_reader import LEVELS, SERVICES, LogLine, LogReader

Row = tuple[float, str, str, str, bool]  # when [s, the host's wall clock], level, service, text, begins
PERIOD = 1.0  # between two messages from a host [s]
ORDER_TIMEOUT = 20.0  # until a host has received the order [s]


def write(
    instance: Instance, output: FileIO, *, service: str | None, since: float | None, level: str, lines: int | None
) -> None:
    """Write this host's log lines as JSON, a list each period; raises ``BrokenPipeError`` if the reader is gone."""
    if not (instance.logs / f"{service}.log").exists() and (service or not any(instance.logs.glob("*.log"))):
        output.write(b"[]\n")
        return
    begin = None if since is None else datetime.fromtimestamp(since)
    with LogReader(instance, service, begin, level, lines) as reader:
        while True:
            rows = [(each.when.timestamp(), each.level, each.service, each.text, each.begins) for each in reader.take()]
            output.write(msgspec.json.encode(rows) + b"\n")
            time.sleep(PERIOD)


class HostsLogs:
    """Reads one log, or all, of all hosts of this computer's network. A context manager, as ``LogReader``."""

    def __init__(
        self, instance: Instance, service: str | None, since: datetime | None, level: str, lines: int | None
    ) -> None:
        """As ``LogReader``. Raises ``ConfigurationError``: unknown service or level."""
        if service is not None:
            require_one_of("service", service, SERVICES)
        if level:
            require_one_of("--level", level, LEVELS)
        self._settings = instance.settings()
        arguments = {"since": None if since is None else since.timestamp(), "lines": lines}
        self._order = Order("logs", instance.name, {"service": service, "level": level} | arguments)
        self._running = contextlib.ExitStack()
        self._sending: list[tuple[Host, Popen[bytes]]] = []
        self.problems: tuple[str, ...] = ()

    def __enter__(self) -> Self:
        for host in self._settings.beside(self._settings.here):
            self._sending.append((host, self._running.enter_context(carrier(self._settings, host))))
        for host, process in list(self._sending):
            with self._reported(host, process):
                send(process, self._settings, host, self._order, ORDER_TIMEOUT)
        return self

    def __exit__(self, *exception: object) -> None:
        self._running.close()

    def take(self) -> list[LogLine]:
        """One period's lines by time; ``problems``: of unreachable hosts. Raises ``ValorError``: no such log."""
        found: list[Row] = []
        for host, process in list(self._sending):
            with self._reported(host, process):
                assert process.stdout is not None and process.stderr is not None
                if not (line := process.stdout.readline()):
                    if (status := process.wait()) == 0:
                        self._sending.remove((host, process))
                        continue
                    raise ended(self._settings, host, status, process.stderr.read())
                message = msgspec.json.decode(line, type=list[Row] | Reply)
                if isinstance(message, Reply):
                    raise HostError(f"{host.name}: {message.error}")
                found += message
        if not found and not self._sending and self.problems:
            raise ValorError("\n".join(self.problems))
        lines = [LogLine(datetime.fromtimestamp(row[0]), *row[1:]) for row in found]
        return sorted(lines, key=lambda line: line.when)

    def wait(self) -> list[LogLine]:
        """As ``take``; returns after a period, also if no host sends any more."""
        if not self._sending:
            time.sleep(PERIOD)
        return self.take()

    @contextlib.contextmanager
    def _reported(self, host: Host, process: Popen[bytes]) -> Iterator[None]:
        """Add an error to the problems, and receive nothing more from its host."""
        try:
            yield
        except HostError as error:
            self.problems += (str(error),)
            self._sending.remove((host, process))
