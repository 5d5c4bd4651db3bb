"""An instance's supervisord: start, XML-RPC over its Unix socket, and errors for an instance that is not up."""

import http.client
import os
import re
import socket
import subprocess
import sys
import time
import xmlrpc.client
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, Literal, cast
from xml.parsers.expat import ExpatError

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.processes import Process
from valor.valorctl.instance import supervisor_config

START_TIMEOUT = 15.0  # until supervisord answers [s]
CALL_TIMEOUT = 5.0  # [s]
_TAIL_LINES = 12


class SupervisorError(ValorError):
    """supervisord does not respond, or rejected a call."""


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
    """State of a process according to supervisord."""

    name: str
    state: ProcessState
    pid: int  # 0 if not running
    uptime: float  # [s]
    exit_status: int  # of the last end; -1 after a signal
    problem: str  # why it could not be started


class _Transport(xmlrpc.client.Transport):
    """HTTP over a Unix socket with a timeout, which supervisor's own transport lacks."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self._file = file

    def make_connection(self, host: object) -> http.client.HTTPConnection:
        connection = http.client.HTTPConnection("localhost", timeout=CALL_TIMEOUT)
        connection.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.sock.settimeout(CALL_TIMEOUT)
        connection.sock.connect(str(self._file))
        return connection


@dataclass(frozen=True)
class HostState:
    """A host of the instance; ``problem``: why it is not reachable, empty if it is."""

    name: str
    address: str
    processes: tuple[str, ...]
    problem: str = ""


class Supervisor:
    """A running supervisord. Methods raise ``SupervisorError`` if it does not respond or rejects the call."""

    def __init__(self, instance: Instance, socket_file: Path | None = None) -> None:
        """Of an instance; ``socket_file``: where supervisord is reached, if not in the instance's folder."""
        self._name = instance.name
        self._config = supervisor_config.config_file(instance)
        self._logs = instance.logs
        file = socket_file or supervisor_config.socket_file(instance)
        self._proxy = xmlrpc.client.ServerProxy("http://localhost/RPC2", transport=_Transport(file))

    def _call(self, method: str, *arguments: object, namespace: str = "supervisor") -> Any:
        try:
            return getattr(getattr(self._proxy, namespace), method)(*arguments)
        except xmlrpc.client.Fault as fault:
            raise SupervisorError(f"supervisord: {method}{arguments}: {fault.faultString}") from None
        except (OSError, http.client.HTTPException, xmlrpc.client.Error, ExpatError) as error:
            raise SupervisorError(
                f"supervisord of instance {self._name!r} does not respond: {error or type(error).__name__}"
            ) from None

    def close(self) -> None:
        """Do nothing."""

    def hosts(self) -> list[HostState]:
        """An empty list: all processes run on this computer."""
        return []

    def answers(self) -> bool:
        """Return whether supervisord responds."""
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
        self._order("start", name)

    def stop(self, names: Iterable[str], timeout: float) -> None:
        """Stop processes together, and wait until none runs."""
        waiting = {name for name, info in self.processes().items() if info.pid and name in set(names)}
        for name in waiting:
            try:
                self._order("stop", name)
            except SupervisorError:
                if self.processes()[name].pid:  # otherwise the process ended meanwhile
                    raise
        deadline = time.monotonic() + timeout
        while waiting := {name for name, info in self.processes().items() if info.pid and name in waiting}:
            if time.monotonic() > deadline:
                raise SupervisorError(f"not stopped within {timeout:g} s: {', '.join(sorted(waiting))}")
            time.sleep(0.02)

    def _order(self, action: Literal["start", "stop"], name: str) -> None:
        self._call(f"{action}Process", name, False)

    def run(self) -> str:
        """The run of the instance that it supervises."""
        return str(self._call("getIdentification"))

    def add(self, processes: Iterable[Process]) -> None:
        """Add processes to the configuration, without starting them."""
        self._config.write_text(self._config.read_text() + supervisor_config.programs(processes))
        self._call("reloadConfig")
        for process in processes:
            self._call("addProcessGroup", process.name)

    def remove(self, processes: Iterable[Process]) -> None:
        """Remove stopped processes from the configuration."""
        self._config.write_text(self._config.read_text().replace(supervisor_config.programs(processes), ""))
        self._call("reloadConfig")
        for process in processes:
            self._call("removeProcessGroup", process.name)

    def shutdown(self) -> None:
        """Request that supervisord stops all processes and ends; returns at once."""
        self._call("shutdown")

    def restarts(self) -> dict[str, int]:
        """Number of restarts after unexpected ends since ``up``, by process."""
        return count_restarts(self._main_log())

    def last_end(self, info: ProcessInfo) -> str:
        """Last end of a process: exit status or signal."""
        return last_end(self._main_log(), info.name) or f"exit status {info.exit_status}"

    def _main_log(self) -> str:
        try:
            return (self._logs / "supervisord.log").read_text(errors="replace")
        except FileNotFoundError:
            return ""

    def log_tail(self, name: str) -> str:
        """The last lines of a process's log, as the end of an error message."""
        file = self._logs / f"{name}.log"
        try:
            return tail(str(file), file.read_text(errors="replace"))
        except OSError:
            return ""


def tail(file: str, text: str) -> str:
    """The last lines of a log, to follow an error's text."""
    lines = text.splitlines()[-_TAIL_LINES:]
    return "".join(f"\n  {line}" for line in [f"{file}:", *lines]) if lines else f" (its log {file} is empty)"


def count_restarts(log: str) -> dict[str, int]:
    """Unexpected ends by process, from the text of supervisord's log (a new one after each ``up``)."""
    return dict(Counter(re.findall(r"WARN exited: (\S+) \(.*; not expected\)", log)))


def last_end(log: str, name: str) -> str:
    """A process's last end in supervisord's log; supervisord does not store it after another start."""
    ends = re.findall(rf" exited: {re.escape(name)} \((.*); (?:not )?expected\)", log)
    return str(ends[-1]) if ends else ""


def launch(instance: Instance, processes: Iterable[Process], held: int, check: Callable[[], None]) -> Supervisor:
    """Start supervisord in a new session, without starting the processes; ``check`` may raise to end the wait.

    It keeps the descriptor ``held``; its processes do not have it. Raises ``SupervisorError`` with its output.
    """
    supervisor = Supervisor(instance)
    config = supervisor_config.config_file(instance)
    config.write_text(supervisor_config.render(processes))
    output = instance.logs / "supervisord.out"
    with open(output, "wb") as out:
        child = subprocess.Popen(
            [sys.executable, "-m", "supervisor.supervisord", "-c", str(config)],
            cwd=instance.logs,  # where libraries such as MuJoCo write their logs
            env=supervisor_config.environment(instance, sys.executable, os.environ),
            stdin=held,  # supervisord closes other descriptors, and does not read this one
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
            raise SupervisorError(f"supervisord does not respond within {START_TIMEOUT:g} s; see {output}")
        time.sleep(0.02)
    return supervisor
