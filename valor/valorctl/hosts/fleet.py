"""The hosts of an instance's network, together: their processes, and who of them is gone."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from typing import Any, Self

from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.common.processes import DAEMON
from valor.valorctl.hosts.channel import GoneError, HostError, Switchboard
from valor.valorctl.hosts.credentials import Credentials
from valor.valorctl.supervision import HostState, ProcessInfo, ProcessState


class Fleet:
    """Starts, stops and looks after an instance's processes, wherever they run. A context manager.

    Every method raises ``HostError`` when the host that it needs does not answer or refuses; a look at all of them
    does not.
    """

    def __init__(self, instance: Instance, settings: Settings) -> None:
        """Of an instance.

        Raises:
            ConfigurationError: this computer has not joined the deployment.
        """
        self._name = instance.name
        hosts = settings.beside(settings.here)
        self._hosts = {host.name: host for host in hosts}
        self._here = settings.here
        self._homes = {process: host.name for host in hosts for process in host.processes}
        self._homes[DAEMON] = self._here
        self._answers: dict[str, Any] = {}
        self.switchboard = Switchboard(Credentials.of(instance, settings.deployment).network())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Hang up."""
        self.switchboard.close()

    def processes(self) -> dict[str, ProcessInfo]:
        """All processes by name; bifrostd is this host's."""
        infos: dict[str, ProcessInfo] = {}
        answers = self._answers = self._ask_all("processes")
        for name, answer in answers.items():
            if isinstance(answer, HostError):
                problem = self.told(name, answer)
                missing = (*self._hosts[name].processes, *((DAEMON,) if name == self._here else ()))
                infos |= {each: ProcessInfo(each, ProcessState.UNKNOWN, 0, 0.0, 0, problem) for each in missing}
                continue
            for row in answer:
                if self._homes.get(row["name"]) == name:
                    infos[row["name"]] = ProcessInfo(**row | {"state": ProcessState(row["state"])})
        return infos

    def hosts(self) -> list[HostState]:
        """How every host fared when the processes were looked at last."""
        answers = self._answers or self._ask_all("processes")
        return [
            HostState(host.name, host.address, host.processes, self._problem(host.name, answers[host.name]))
            for host in self._hosts.values()
        ]

    def start(self, name: str) -> None:
        """Start a process; returns once it is spawned."""
        self._call(name, "start", name=name)

    def stop(self, names: Iterable[str], timeout: float) -> None:
        """Stop processes, and wait until none of them runs."""
        by_host: dict[str, list[str]] = {}
        for name in names:
            by_host.setdefault(self._homes[name], []).append(name)
        require(
            self._ask({host: {"names": each, "timeout": timeout} for host, each in by_host.items()}, "stop", timeout)
        )

    def restarts(self) -> dict[str, int]:
        """How often each process was restarted because it had ended by itself, as far as its host answers."""
        found: dict[str, int] = {}
        for name, answer in self._ask_all("restarts").items():
            if not isinstance(answer, HostError):
                found |= {each: count for each, count in answer.items() if self._homes.get(each) == name}
        return found

    def last_end(self, info: ProcessInfo) -> str:
        """How a process ended last."""
        return str(self._call(info.name, "last_end", name=info.name))

    def log_tail(self, name: str) -> str:
        """The last lines of a process' log, to be put behind an error's text; without its host, nothing."""
        try:
            return str(self._call(name, "log_tail", name=name))
        except HostError:
            return ""

    def ask(self, verb: str, timeout: float, hosts: Iterable[str] | None = None, **arguments: Any) -> dict[str, Any]:
        """Ask hosts, by default all, the same of the instance; by host what it answered, or the ``HostError``."""
        return self._ask(dict.fromkeys(self._hosts if hosts is None else hosts, arguments), verb, timeout)

    def told(self, name: str, error: HostError) -> str:
        """What to say of a host that does not answer: that, and its last word."""
        if not isinstance(error, GoneError):
            return str(error)
        try:
            others = self.switchboard.ask("others", {self._here: {}})[self._here]
        except ValorError:
            return str(error)
        if isinstance(others, HostError) or name not in others:
            return f"host {name} ({self._hosts[name].address}) is gone, without a word"
        heard, word = others[name]["heard"], others[name]["word"]
        ago = time.monotonic() - heard  # this host's agent goes by the same clock
        return f"host {name} ({self._hosts[name].address}) is gone; its last word, {ago:.0f} s ago: {word}"

    # --------------------------------------------------------------------------------------------------------------

    def _ask(self, arguments: Mapping[str, Mapping[str, Any]], verb: str, timeout: float) -> dict[str, Any]:
        sent = {host: {"instance": self._name, **each} for host, each in arguments.items()}
        return self.switchboard.ask(verb, sent, timeout=timeout)

    def _ask_all(self, verb: str) -> dict[str, Any]:
        return self._ask({name: {} for name in self._hosts}, verb, 5.0)

    def _call(self, process: str, verb: str, **arguments: Any) -> Any:
        host = self._homes[process]
        return require(self._ask({host: arguments}, verb, 5.0))[host]

    def _problem(self, name: str, answer: Any) -> str:
        return self.told(name, answer) if isinstance(answer, HostError) else ""


def require(answers: Mapping[str, Any]) -> Mapping[str, Any]:
    """The answers, if every host gave one.

    Raises:
        HostError: a line for each that did not.
    """
    errors = [str(answer) for answer in answers.values() if isinstance(answer, HostError)]
    if errors:
        raise HostError("\n".join(errors))
    return answers
