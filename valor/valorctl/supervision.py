"""supervisord: start it, and speak XML-RPC with it over its unix socket."""

from __future__ import annotations

import contextlib
import http.client
import re
import socket
import subprocess
import sys
import time
import xmlrpc.client
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, Protocol, cast
from xml.parsers.expat import ExpatError

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.processes import Process
from valor.valorctl import supervisor_config

START_TIMEOUT = 15.0  # until supervisord answers [s]
CALL_TIMEOUT = 5.0  # [s]
_TAIL_LINES = 12


class SupervisorError(ValorError):
    """supervisord does not answer, or refused a call."""


class ProcessState(IntEnum):
    """supervisord's process states (http://supervisord.org/subprocess.html#process-states)."""

    STOPPED = 0
    STARTING = 10
    RUNNING = 20
    BACKOFF = 30
    STOPPING = 40
    EXITED = 100
    FATAL = 200
    UNKNOWN = 1000


@dataclass(frozen=True)
class ProcessInfo:
    """What supervisord knows of a process."""

    name: str
    state: ProcessState
    pid: int  # 0: does not run
    uptime: float  # [s]
    exit_status: int  # of its last end; -1: by a signal
    problem: str  # why it could not be started


class _Connection(http.client.HTTPConnection):
    """HTTP over a unix socket."""

    def __init__(self, file: Path) -> None:
        super().__init__("localhost", timeout=CALL_TIMEOUT)
        self._file = file

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self.timeout)
        self.sock.connect(str(self._file))


class _Transport(xmlrpc.client.Transport):
    """supervisor's own client transport waits for ever; this one gives up."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self._file = file

    def make_connection(self, host: object) -> http.client.HTTPConnection:
        return _Connection(self._file)


@dataclass(frozen=True)
class HostState:
    """How a host fares: ``problem`` is empty, or says what is wrong with it, and its last word."""

    name: str
    address: str
    processes: tuple[str, ...]
    problem: str = ""


class Supervising(Protocol):
    """What starts and stops processes: a supervisord, or those of several hosts together."""

    def close(self) -> None:
        """Hold nothing any more."""

    def hosts(self) -> list[HostState]:
        """How every host fares; none: all is on this computer."""

    def processes(self) -> dict[str, ProcessInfo]:
        """All processes by name."""

    def start(self, name: str) -> None:
        """Start a process; returns once it is spawned."""

    def stop(self, names: Iterable[str], timeout: float) -> None:
        """Stop processes at once, and wait until none of them runs."""

    def restarts(self) -> dict[str, int]:
        """How often each process was restarted because it had ended by itself, since ``up``."""

    def last_end(self, info: ProcessInfo) -> str:
        """How a process ended last: an exit status, or a signal."""

    def log_tail(self, name: str) -> str:
        """The last lines of a process' log, to be put behind an error's text."""


class Supervisor:
    """A running supervisord.

    Every method raises ``SupervisorError`` when it does not answer or refuses.
    """

    def __init__(self, instance: Instance) -> None:
        self._name = instance.name
        self._log = supervisor_config.log_file(instance)
        self._logs = instance.logs
        self._proxy = xmlrpc.client.ServerProxy(
            "http://localhost/RPC2", transport=_Transport(supervisor_config.socket_file(instance))
        )

    def _call(self, method: str, *arguments: object) -> Any:
        try:
            return getattr(self._proxy.supervisor, method)(*arguments)
        except xmlrpc.client.Fault as fault:
            raise SupervisorError(f"supervisord: {method}{arguments}: {fault.faultString}") from None
        except (OSError, http.client.HTTPException, xmlrpc.client.Error, ExpatError) as error:
            raise SupervisorError(
                f"supervisord of instance {self._name!r} does not answer: {error or type(error).__name__}"
            ) from None

    def close(self) -> None:
        """Nothing is held."""

    def hosts(self) -> list[HostState]:
        """How every host fares: it is this computer's alone."""
        return []

    def answers(self) -> bool:
        """Whether it is there."""
        try:
            self._call("getState")
        except SupervisorError:
            return False
        return True

    def processes(self) -> dict[str, ProcessInfo]:
        """All processes by name."""
        rows = cast("list[dict[str, Any]]", self._call("getAllProcessInfo"))
        return {
            row["name"]: ProcessInfo(
                name=row["name"],
                state=ProcessState(row["state"]),
                pid=row["pid"],
                uptime=float(row["now"] - row["start"]) if row["pid"] else 0.0,
                exit_status=row["exitstatus"],
                problem=row["spawnerr"],
            )
            for row in rows
        }

    def start(self, name: str) -> None:
        """Start a process; returns once it is spawned."""
        self._call("startProcess", name, False)

    def stop(self, names: Iterable[str], timeout: float) -> None:
        """Stop processes at once, and wait until none of them runs."""
        waiting = {name for name, info in self.processes().items() if info.pid and name in set(names)}
        for name in waiting:
            try:
                self._call("stopProcess", name, False)
            except SupervisorError:
                if self.processes()[name].pid:  # else it ended in between
                    raise
        deadline = time.monotonic() + timeout
        while waiting := {name for name, info in self.processes().items() if info.pid and name in waiting}:
            if time.monotonic() > deadline:
                raise SupervisorError(f"not stopped within {timeout:g} s: {', '.join(sorted(waiting))}")
            time.sleep(0.02)

    def shutdown(self) -> None:
        """Have it stop everything and end; returns at once."""
        self._call("shutdown")

    def restarts(self) -> dict[str, int]:
        """How often each process was restarted because it had ended by itself, since ``up``."""
        return count_restarts(self._log)

    def last_end(self, info: ProcessInfo) -> str:
        """How a process ended last: an exit status, or a signal."""
        return last_end(self._log, info.name) or f"exit status {info.exit_status}"

    def log_tail(self, name: str) -> str:
        """The last lines of a process' log, to be put behind an error's text."""
        file = self._logs / f"{name}.log"
        try:
            lines = file.read_text(errors="replace").splitlines()[-_TAIL_LINES:]
        except OSError:
            return ""
        return "".join(f"\n  {line}" for line in [f"{file}:", *lines]) if lines else f" (its log {file} is empty)"


def count_restarts(log: Path) -> dict[str, int]:
    """Unexpected ends by process, from supervisord's log (which is begun anew by each ``up``)."""
    counts: dict[str, int] = {}
    try:
        text = log.read_text(errors="replace")
    except FileNotFoundError:
        return counts
    for match in re.finditer(r"WARN exited: (\S+) \(.*; not expected\)", text):
        counts[match[1]] = counts.get(match[1], 0) + 1
    return counts


def last_end(log: Path, name: str) -> str:
    """How a process ended last, in supervisord's words: an exit status, or a signal; empty: not at all.

    Of a process that was begun anew since, supervisord itself has forgotten it.
    """
    with contextlib.suppress(FileNotFoundError):
        text = log.read_text(errors="replace")
        if ends := re.findall(rf" exited: {re.escape(name)} \((.*); (?:not )?expected\)", text):
            return str(ends[-1])
    return ""


def launch(
    instance: Instance,
    processes: Iterable[Process],
    environment: dict[str, str],
    held: int,
    check: Callable[[], None],
) -> Supervisor:
    """Start supervisord in a session of its own; no process is started yet.

    Args:
        instance: its folder holds configuration and socket.
        processes: those that can be started then.
        environment: of supervisord and all of them.
        held: a descriptor that supervisord keeps open as long as it lives, and its processes do not.
        check: called while waiting; may raise to give up.

    Raises:
        ValorError: it did not come up; carries its words.
    """  # fmt: skip
    supervisor = Supervisor(instance)
    config = supervisor_config.config_file(instance)
    config.write_text(supervisor_config.render(processes))
    output = instance.logs / "supervisord.out"
    with open(output, "wb") as out:
        child = subprocess.Popen(
            [sys.executable, "-m", "supervisor.supervisord", "-c", str(config)],
            cwd=instance.logs,  # where libraries, MuJoCo for one, leave their own logs
            env=environment,
            stdin=held,  # which it never reads; others it closes
            stdout=out,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    deadline = time.monotonic() + START_TIMEOUT
    while not supervisor.answers():
        check()
        if child.poll() is not None:
            words = " ".join(output.read_text(errors="replace").split())
            raise SupervisorError(f"supervisord ended with {child.returncode}: {words[-500:]}")
        if time.monotonic() > deadline:
            raise SupervisorError(f"supervisord does not answer within {START_TIMEOUT:g} s; see {output}")
        time.sleep(0.02)
    return supervisor
