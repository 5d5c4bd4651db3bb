"""Running instances and their processes, supervised or not, on this computer or on several."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.common.linking import robots_hosts
from valor.common.processes import BY_NAME, SUPERVISED
from valor.valorctl.instance.supervision import ProcessInfo, ProcessState, Supervisor

if TYPE_CHECKING:
    import psutil

    from valor.valorctl.hosts.fleet import Fleet


@dataclass(frozen=True)
class Supervised:
    """A supervisord of any instance, or one of its processes."""

    process: psutil.Process
    home: str
    instance: str
    command: str


def supervised_processes(instance: Instance | None = None) -> list[Supervised]:
    """The processes of one instance, or of all, of every user whose processes are accessible."""
    import psutil  # not needed where supervisord responds

    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            environment = process.environ()
            if SUPERVISED in environment and process.status() != psutil.STATUS_ZOMBIE:
                found.append(
                    Supervised(
                        process,
                        environment.get("VALOR_HOME", ""),
                        environment.get("VALOR_INSTANCE", ""),
                        " ".join(process.cmdline()),
                    )
                )
    if instance is None:
        return found
    home = str(instance.folder.parent)
    return [process for process in found if (process.home, process.instance) == (home, instance.name)]


def require_up(instance: Instance) -> Supervisor | Fleet:
    """The supervisor of an instance, on one computer or several; raises ``ValorError`` if it does not respond."""
    if (settings := instance.settings()).hosts:
        return supervising(instance, settings)
    supervisor = Supervisor(instance)
    if not supervisor.answers():
        raise ValorError(unsupervised(instance, len(processes_found(instance))))
    return supervisor


def supervising(instance: Instance, settings: Settings) -> Supervisor | Fleet:
    """What starts and stops the processes of an instance that is up: this computer's supervisord, or all hosts'."""
    if not settings.hosts:
        return Supervisor(instance)
    from valor.valorctl.hosts.fleet import Fleet

    return Fleet(instance, settings)


def require_running() -> Instance:
    """The environment's instance; raises ``ValorError`` if none of its processes runs, or the robot is elsewhere."""
    instance = Instance.from_environment()
    if robots := robots_hosts(instance.settings()):
        raise ValorError(
            f"this host is on the operator's side of the link: run the verb on {' or '.join(robots)}, by ssh; "
            f"from here command the robot with the operator's page, ROS 2 and `valorctl stop`"
        )
    if not Supervisor(instance).answers() and not processes_found(instance):
        raise ValorError(unsupervised(instance, 0))
    return instance


def unsupervised(instance: Instance, left: int) -> str:
    """Error message about an instance without a supervisor, of which ``left`` processes run."""
    option = Instance.option(instance.name)
    if not left:
        return f"instance {instance.name!r} has crashed: no process runs; `valorctl up{option}` starts it again"
    return (
        f"instance {instance.name!r}: its supervisor does not respond, so its {left} remaining processes are not "
        f"restarted; `valorctl down{option}` stops them"
    )


def processes_found(instance: Instance) -> dict[str, ProcessInfo]:
    """The running processes of an instance, found without its supervisor."""
    by_module = {process.module: name for name, process in BY_NAME.items()}
    running = {}
    for process in supervised_processes(instance):
        name = by_module.get(process.command.rpartition(" ")[2])
        if name:
            uptime = time.time() - process.process.create_time()
            running[name] = ProcessInfo(name, ProcessState.RUNNING, process.process.pid, uptime, 0, "")
    return running
