"""The hosts of an instance's network: one supervisord each, the others' over sockets that ssh forwards."""

import contextlib
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal, Self

from valor.common.instance import Host, Instance, Settings
from valor.common.processes import DAEMON
from valor.valorctl.hosts.remote import GoneError, HostError, command, gone
from valor.valorctl.instance import supervisor_config
from valor.valorctl.instance.supervision import (
    CALL_TIMEOUT,
    HostState,
    ProcessInfo,
    ProcessState,
    Supervisor,
    SupervisorError,
    tail,
)

LOGIN_TIMEOUT = 15.0  # until the forwarded socket exists [s]
RETRY_PERIOD = 10.0  # between two attempts to reach a host [s]
LOG_TAIL = 4000  # [B]


class _RemoteSupervisor(Supervisor):
    """supervisord of another host, over a socket that ssh forwards.

    Start and stop calls have a deadline by its clock; logs are read through it. Methods raise ``GoneError`` if the host
    is unreachable, else ``HostError``.
    """

    def __init__(self, instance: Instance, settings: Settings, host: Host, near: Path) -> None:
        super().__init__(instance, near)
        self._settings, self._host, self._near = settings, host, near
        self._errors = near.with_suffix(".errors")
        self._gone: tuple[float, GoneError] | None = None  # when the host was found unreachable [s], and why
        self._connect()

    def _connect(self) -> None:
        """Start ssh, which binds the near socket after login, and ends with this process: `cat` reads from it."""
        forwarding = f"{self._near}:{Path(self._host.folder, supervisor_config.SOCKET)}"
        self._ready = False
        with open(self._errors, "wb") as errors:
            self._ssh = subprocess.Popen(
                [*command(self._settings, self._host, "-L", forwarding), "cat"],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,  # Ctrl-C must not end it before what needs it
            )

    def close(self) -> None:
        """End ssh."""
        self._ssh.kill()
        with contextlib.suppress(BrokenPipeError):
            self._ssh.communicate()
        self._near.unlink(missing_ok=True)

    def _require(self) -> None:
        """Wait until ssh is connected; after an error, connect again, but not more often than each period."""
        if self._gone is not None:
            if time.monotonic() - self._gone[0] < RETRY_PERIOD:
                raise self._gone[1]
            self.close()
            self._connect()
            self._gone = None
        deadline = time.monotonic() + LOGIN_TIMEOUT
        while (ended := self._ssh.poll() is not None) or not self._listens():
            if ended or time.monotonic() > deadline:
                text = self._errors.read_text(errors="replace") if ended else f"no login within {LOGIN_TIMEOUT:g} s"
                self._gone = time.monotonic(), gone(self._host, text)
                raise self._gone[1]
            time.sleep(0.005)

    def _listens(self) -> bool:
        if not self._ready:
            with socket.socket(socket.AF_UNIX) as probe, contextlib.suppress(OSError):
                probe.connect(str(self._near))
                self._ready = True
        return self._ready

    def _call(self, method: str, *arguments: object, namespace: str = "supervisor") -> Any:
        self._require()
        try:
            return super()._call(method, *arguments, namespace=namespace)
        except SupervisorError as error:
            self._require()
            raise HostError(f"{self._host.name}: {error}") from None

    def _order(self, action: Literal["start", "stop"], name: str) -> None:
        until = self._call("clock", namespace=supervisor_config.NAMESPACE) + CALL_TIMEOUT
        self._call(action, name, until, namespace=supervisor_config.NAMESPACE)

    def _main_log(self) -> str:
        return str(self._call("readLog", 0, 0))

    def log_tail(self, name: str) -> str:
        try:
            return tail(f"{name}.log", str(self._call("readProcessStdoutLog", name, -LOG_TAIL, 0)))
        except SupervisorError:
            return ""


class Fleet:
    """Starts, stops and reports an instance's processes, on whichever host they run. A context manager.

    Methods about one process raise ``SupervisorError`` if its host is unreachable or rejects the call; reports about
    all processes do not.
    """

    def __init__(self, instance: Instance, settings: Settings) -> None:
        """Start to connect to all hosts of this computer's network, on which the instance has been made."""
        self._here = settings.here
        self._hosts = {host.name: host for host in settings.beside(settings.here)}
        self._homes = {process: host.name for host in self._hosts.values() for process in host.processes}
        self._homes[DAEMON] = settings.here
        self._folder = tempfile.TemporaryDirectory(prefix="valor-")  # short: a socket's path has at most 107 bytes
        self._problems: dict[str, str] = {}
        self._supervisors: dict[str, Supervisor] = {}
        for name, host in self._hosts.items():
            near = Path(self._folder.name, f"{name}.sock")
            self._supervisors[name] = (
                Supervisor(instance) if name == self._here else _RemoteSupervisor(instance, settings, host, near)
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect."""
        for supervisor in self._supervisors.values():
            supervisor.close()
        self._folder.cleanup()

    def processes(self) -> dict[str, ProcessInfo]:
        """All processes by name; bifrostd is this host's."""
        infos: dict[str, ProcessInfo] = {}
        for name, supervisor in self._supervisors.items():
            own = [process for process, home in self._homes.items() if home == name]
            try:
                found = supervisor.processes()
                self._problems[name] = ""
            except SupervisorError as error:
                self._problems[name] = str(error)
                found = {each: ProcessInfo(each, ProcessState.UNKNOWN, 0, 0.0, 0, str(error)) for each in own}
            infos |= {each: info for each, info in found.items() if each in own}
        return infos

    def hosts(self) -> list[HostState]:
        """State of every host when the processes were last requested."""
        if not self._problems:
            self.processes()
        return [
            HostState(host.name, host.address, host.processes, self._problems[host.name])
            for host in self._hosts.values()
        ]

    def runs(self) -> dict[str, str | None]:
        """The run that each other host supervises; None: it is unreachable; empty: its supervisord does not respond."""
        found: dict[str, str | None] = {}
        for name in self._hosts:
            if name != self._here:
                try:
                    found[name] = self._supervisors[name].run()
                except GoneError:
                    found[name] = None
                except HostError:
                    found[name] = ""
        return found

    def start(self, name: str) -> None:
        """Start a process; returns once it is spawned."""
        self._of(name).start(name)

    def stop(self, names: Iterable[str], timeout: float) -> None:
        """Stop processes, and wait until none of them runs."""
        by_host: dict[str, list[str]] = {}
        for name in names:
            by_host.setdefault(self._homes[name], []).append(name)
        for host, own in by_host.items():
            self._supervisors[host].stop(own, timeout)

    def restarts(self) -> dict[str, int]:
        """How often supervisord restarted each process since ``up``, as far as its host is reachable."""
        found: dict[str, int] = {}
        for name, supervisor in self._supervisors.items():
            with contextlib.suppress(SupervisorError):
                counts = supervisor.restarts()
                found |= {each: count for each, count in counts.items() if self._homes.get(each) == name}
        return found

    def last_end(self, info: ProcessInfo) -> str:
        """How a process ended last: an exit status, or a signal."""
        return self._of(info.name).last_end(info)

    def log_tail(self, name: str) -> str:
        """The last lines of a process' log, to follow an error's text; empty if its host is unreachable."""
        return self._of(name).log_tail(name)

    def _of(self, process: str) -> Supervisor:
        return self._supervisors[self._homes[process]]
