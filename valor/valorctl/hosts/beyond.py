"""The robot's side of the link, as `valorctl` on the operator's has it: verbs are done there, and told here.

Each is sent once and done once, within the deadline of a command; how it fares is asked of link_operator.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import datetime
from typing import Self

import msgspec

import bifrost
from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.common.linking import NAMES, robots_hosts
from valor.common.messages import BeyondReply, BeyondRequest
from valor.common.processes import DAEMON
from valor.common.topics import BEYOND
from valor.valorctl.health import Health
from valor.valorctl.hosts.relayed import Told
from valor.valorctl.log_reader import Line
from valor.valorctl.node import join
from valor.valorctl.supervision import HostState

REPLY = 2.0  # of link_operator [s]
PERIOD = 0.1  # between two questions [s]
LOOKING = 25.0  # for how it fares there [s]
LONG = 180.0  # for a process to begin anew, or to end; for a log [s]
GONE = 3.0  # silent for so long, the robot's end has ended [s]
ENDING = 40.0  # until then [s]


class BeyondError(ValorError):
    """What was asked of the robot's side was not done, or nobody knows."""


class Beyond:
    """A context manager."""

    def __init__(self, instance: Instance, settings: Settings, check: Callable[[], None] = lambda: None) -> None:
        """Of an instance that is up on this side; ``check``: called while waiting; may raise to give up."""
        self._settings, self._check = settings, check
        self._node = join(instance)
        self._client = BEYOND.client(self._node)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._node.close()

    def close(self) -> None:
        """Leave."""
        self._node.close()

    @property
    def advice(self) -> str:
        """What to do there."""
        return there(self._settings)

    def do(self, *words: str, timeout: float = LONG, last: bool = False) -> str:
        """Have a verb done there; what was said to it, or nothing of one that ends the robot's end, the ``last``.

        Raises:
            BeyondError: it was not, or nobody knows; says why, and what to do.
        """
        began = time.monotonic()
        told = self._call(BeyondRequest(list(words), 0))
        while told.state not in ("ended", "lost"):
            if time.monotonic() - began > timeout:
                silent = f", the robot's end silent for {told.silent:.0f} s"
                raise BeyondError(f"{words[0]} through the link: {told.state}, no answer in {timeout:g} s{silent}")
            if last and told.state == "begun" and told.silent > GONE:
                return ""
            self._check()
            time.sleep(PERIOD)
            told = self._call(BeyondRequest([], told.number))
        return self._said(words[0], told)

    def _said(self, verb: str, told: BeyondReply) -> str:
        if told.state == "lost":
            raise BeyondError(f"{verb} through the link: {told.said}; {self.advice}")
        if told.status:
            raise BeyondError(f"{verb} on the robot's side: {told.said.strip()}")
        return told.said.strip()

    def _call(self, request: BeyondRequest) -> BeyondReply:
        try:
            return self._client.call(request, timeout=REPLY)
        except bifrost.Error:
            raise BeyondError(f"{NAMES[1]} does not answer: `valorctl status`, `valorctl restart {NAMES[1]}`") from None

    def status(self) -> tuple[Told, float]:
        """How the robot's side fares, and how old that is at most [s].

        Raises:
            BeyondError: as of ``do``.
        """
        began = time.monotonic()
        told = msgspec.json.decode(self.do("status", timeout=LOOKING), type=Told)
        return told, time.monotonic() - began

    def down(self, tell: Callable[[str], None]) -> None:
        """End the robot's side: first all that moves it, then the rest; ``tell``: what is said of each.

        Raises:
            BeyondError: as of ``do``; or its end of the link goes on.
        """
        tell(self.do("down"))
        if said := self.do("end", last=True):
            tell(said)
        deadline = time.monotonic() + ENDING
        while (told := self._call(BeyondRequest([], 0))).silent < GONE:
            if time.monotonic() > deadline:
                raise BeyondError(f"{NAMES[0]} goes on after {ENDING:g} s; {self.advice}")
            self._check()
            time.sleep(PERIOD)
        tell(f"{NAMES[0]} is silent for {told.silent:.0f} s")


class BeyondLogs:
    """Reads a log there: its last lines, as many as the link takes. A context manager, as ``LogReader``."""

    def __init__(
        self, instance: Instance, service: str | None, since: datetime | None, level: str, lines: int | None
    ) -> None:
        """As ``LogReader``."""
        begin = "" if since is None else f"{since.timestamp():.3f}"
        self._words = ("logs", service or "", level, "" if lines is None else str(lines), begin)
        self._settings = instance.settings()
        self._beyond = Beyond(instance, self._settings)
        self.problems: tuple[str, ...] = ()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._beyond.close()

    def take(self) -> list[Line]:
        """What there is.

        Raises:
            BeyondError: as of ``Beyond.do``.
        """
        rows = msgspec.json.decode(self._beyond.do(*self._words), type=list[tuple[float, str, str, str, bool]])
        return [Line(datetime.fromtimestamp(row[0]), *row[1:]) for row in rows]

    def wait(self) -> list[Line]:
        """What comes is not carried.

        Raises:
            BeyondError: always.
        """
        raise BeyondError(f"--follow is not carried by the link: {' or '.join(robots_hosts(self._settings))} can")


def there(settings: Settings) -> str:
    """What to do on the robot's side."""
    hosts = " or ".join(robots_hosts(settings))
    return f"if {NAMES[0]} does not run: on {hosts}, `valorctl status`, `valorctl up --deployment FILE`"


def fares(settings: Settings, told: Told | None, problem: str) -> tuple[list[Health], list[HostState]]:
    """Of the processes there, but for bifrostd, which each side has, and of the hosts.

    Args:
        settings: of the instance.
        told: by the robot's side; None: nothing.
        problem: why nothing was told.
    """
    robots = [host for host in settings.hosts if not host.operator]
    if told is None:
        names = [name for host in robots for name in host.processes]
        services = [Health(name, "failed", 0, None, None, 0, "not told through the link") for name in names]
        return services, [HostState(host.name, host.address, host.processes, problem) for host in robots]
    services = [
        Health(row.name, row.state, row.pid, row.cpu_percent, row.memory_mib, row.restarts, row.detail)
        for row in told.services
        if row.name != DAEMON
    ]
    problems = told.hosts
    return services, [
        HostState(each.name, each.address, each.processes, problems.get(each.name, "")) for each in robots
    ]
