"""What `valorctl` does on the robot's side of the link for the operator's: ``python -m``, started by link_robot.

    status | restart PROCESS | logs PROCESS LEVEL LINES SINCE | down | end

It prints what the operator's side reads: of ``status`` and ``logs`` JSON, as short as it can be, else lines for a
person. ``down`` ends all but bifrostd and link_robot, which says so; ``end`` the rest, once that has been said.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime

import msgspec

import bifrost
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.linking import NAMES
from valor.common.processes import DAEMON
from valor.link.verbs import LONGEST, deflated
from valor.valorctl import instance_setup, startup, watch
from valor.valorctl.console import Progress
from valor.valorctl.health import State
from valor.valorctl.hosts import together
from valor.valorctl.hosts.fleet import Fleet
from valor.valorctl.hosts.logs import HostsLogs
from valor.valorctl.interruption import Interruption
from valor.valorctl.supervision import ProcessInfo, ProcessState

LATER = 2.0  # so long what link_robot says of its own end is on its way [s]


class Row(msgspec.Struct, array_like=True):
    """How one process fares: of ``Health``, in its order."""

    name: str
    state: State
    pid: int
    cpu_percent: int | None
    memory_mib: int | None
    restarts: int
    detail: str


class Told(msgspec.Struct, array_like=True):
    """How the robot's side fares.

    Attributes:
        hosts: by name those with which something is wrong, and what.
    """

    behavior: str | None
    control_mode: str | None
    services: list[Row]
    hosts: dict[str, str]


def status(instance: Instance) -> str:
    """JSON of ``Told``.

    Raises:
        ValorError: the instance is not up here.
    """
    seen = watch.look(instance)
    services = [
        Row(
            each.name, each.state, each.pid,
            None if each.cpu_percent is None else round(each.cpu_percent),
            None if each.memory_mib is None else round(each.memory_mib),
            each.restarts, each.detail,
        )
        for each in seen.services
    ]  # fmt: skip
    problems = {host.name: host.problem for host in seen.hosts if host.problem}
    return msgspec.json.encode(Told(seen.behavior, seen.control_mode, services, problems)).decode()


def restart(instance: Instance, name: str) -> str:
    """Restart a process.

    Raises:
        ValorError: as of ``startup.restart``.
    """
    if name == NAMES[0]:
        _later("restart", name)
        return f"{name} is restarted; the link begins anew"
    startup.restart(instance, name, Progress(), Interruption())  # which tells of it
    return ""


def logs(instance: Instance, service: str, level: str, lines: str, since: str) -> str:
    """JSON of the last lines, as ``Line`` has them, and as many as the link takes.

    Raises:
        ValorError: no such log.
    """
    begin = datetime.fromtimestamp(float(since)) if since else None
    with HostsLogs(instance, service, begin, level, int(lines) if lines else None) as reader:
        found = reader.take()
    if lines:
        found = found[max(0, len(found) - int(lines)) :]
    rows = [(round(line.when.timestamp(), 3), line.level, line.service, line.text, line.begins) for line in found]
    while len(deflated(text := msgspec.json.encode(rows).decode())) > LONGEST:
        rows = rows[max(1, len(rows) // 8) :]
    return text


def down(instance: Instance) -> str:
    """End all processes but those through which this is said.

    Raises:
        ValorError: one goes on.
    """
    settings = instance.settings()
    names = [name for name in settings.near if name != NAMES[0]]
    with instance_setup.changing(instance), Fleet(instance, settings) as fleet:
        fleet.stop(names, together.DOWN)
        infos = fleet.processes()
    left = [f"{name} ({infos[name].problem or infos[name].state})" for name in names if not _over(infos.get(name))]
    if left:
        raise ValorError(f"not ended: {', '.join(left)}")
    return f"ended: {', '.join(names)}"


def end(instance: Instance) -> str:
    """Take down what is left, a moment later."""
    _later("take_down")
    settings = instance.settings()
    return f"{NAMES[0]} and {DAEMON} end, on {', '.join(host.name for host in settings.beside(settings.here))}"


def _over(info: ProcessInfo | None) -> bool:
    return info is None or info.state in (ProcessState.STOPPED, ProcessState.EXITED, ProcessState.FATAL)


def _take_down(instance: Instance) -> None:
    """What ``end`` has begun."""
    together.take_down(instance, instance.settings())


def _restart(instance: Instance, name: str) -> None:
    """What ``restart`` has begun, of link_robot."""
    startup.restart(instance, name, Progress(), Interruption())


def _later(*words: str) -> None:
    """Have something done that ends link_robot, once that has been said."""
    subprocess.Popen(
        [sys.executable, "-m", __spec__.name, "later", *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


VERBS: Mapping[str, Callable[..., str]] = {each.__name__: each for each in (status, restart, logs, down, end)}
LATE: Mapping[str, Callable[..., object]] = {"restart": _restart, "take_down": _take_down}


def main(words: Sequence[str]) -> int:
    """Do a verb; returns its exit status."""
    try:
        if words[0] == "later":
            time.sleep(LATER)
            LATE[words[1]](Instance.from_environment(), *words[2:])
            return 0
        if words[0] not in VERBS:
            raise ValorError(f"{words[0]}: expected one of {', '.join(VERBS)}")
        if said := VERBS[words[0]](Instance.from_environment(), *words[1:]):
            print(said)
    except (ValorError, bifrost.Error) as error:
        print(error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
