"""Whether an instance runs: what is asked of everything that needs one."""

from __future__ import annotations

import time

from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.common.linking import robots_hosts
from valor.common.processes import BY_NAME
from valor.valorctl.supervision import ProcessInfo, ProcessState, Supervising, Supervisor


def require_up(instance: Instance) -> Supervising:
    """Who starts and stops the instance's processes, on this computer or on several.

    Raises:
        ValorError: it is not up, or its supervisor is gone.
    """
    if (settings := instance.settings()).hosts:
        return supervising(instance, settings)
    supervisor = Supervisor(instance)
    if not supervisor.answers():
        raise ValorError(unsupervised(instance, len(processes_found(instance))))
    return supervisor


def supervising(instance: Instance, settings: Settings) -> Supervising:
    """Who starts and stops the processes of an instance that is up: this computer's supervisord, or all hosts'.

    Raises:
        ConfigurationError: this computer has not joined the deployment.
    """
    if not settings.hosts:
        return Supervisor(instance)
    from valor.valorctl.hosts.fleet import Fleet

    return Fleet(instance, settings)


def require_running(*, through_link: bool = False) -> Instance:
    """The environment's instance, of which something runs: what is needed answers for itself, supervised or not.

    Args:
        through_link: what is needed reaches the robot from an operator's host, too.

    Raises:
        ValorError: it is not up, or has crashed as a whole, or the robot is not reached from here.
    """
    instance = Instance.from_environment()
    robots = robots_hosts(instance.settings())
    if robots and not through_link:
        raise ValorError(
            f"here is the operator's side of the link, which does not carry what this verb needs: run it on "
            f"{' or '.join(robots)}; from here: `mode`, `arm`, `hand`, `step`, `stop`, the operator's page, ROS 2"
        )
    if not Supervisor(instance).answers() and not processes_found(instance):
        raise ValorError(unsupervised(instance, 0))
    return instance


def unsupervised(instance: Instance, left: int) -> str:
    """What to say of an instance whose supervisor is gone."""
    option = Instance.option(instance.name)
    if not left:
        return f"instance {instance.name!r} has crashed: nothing of it runs; `valorctl up{option}` starts it again"
    return (
        f"instance {instance.name!r}: its supervisor does not answer, nothing restarts its {left} processes that are "
        f"left; `valorctl down{option}` clears it away"
    )


def processes_found(instance: Instance) -> dict[str, ProcessInfo]:
    """The processes of an instance that run, without asking its supervisor."""
    from valor.valorctl import leftovers  # psutil and a walk over all processes

    by_module = {process.module: name for name, process in BY_NAME.items()}
    running = {}
    for process in leftovers.supervised_processes(instance):
        name = by_module.get(process.command.rpartition(" ")[2])
        if name:
            uptime = time.time() - process.process.create_time()
            running[name] = ProcessInfo(name, ProcessState.RUNNING, process.process.pid, uptime, 0, "")
    return running
