"""``up`` and ``restart``: start processes in order, and wait until all report that they are ready."""

from __future__ import annotations

import contextlib
import resource
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

from valor.common.behaviors import ControlMode
from valor.common.errors import ConfigurationError, ValorError, expected
from valor.common.instance import Instance, Settings
from valor.common.mode_names import PREPARING
from valor.common.processes import BY_NAME, Process
from valor.valorctl.drive import control_mode
from valor.valorctl.drive.getting_up import BY_HAND, simulated
from valor.valorctl.instance import instance_setup, ros_domain, shutdown, supervision, supervisor_config
from valor.valorctl.instance.running import require_up
from valor.valorctl.instance.supervision import ProcessInfo, ProcessState, Supervisor
from valor.valorctl.status.health import Health, Listener, judge
from valor.valorctl.terminal.console import Interruption, Progress

if TYPE_CHECKING:
    from valor.valorctl.hosts.fleet import Fleet

# Timeout without another process becoming ready [s]: for hanging processes. A process that ends is detected at once.
READY_TIMEOUT = 120.0
PREPARATION_TIMEOUT = 30.0  # [s]
RETRY_PERIOD = 0.5  # [s]
_WITH_STATE = ("device_emulators", "comms_manager", "motion_manager")  # the robot's, in a simulation
UNREPORTED = ""  # instead of the current mode, before the ends of a link have exchanged messages


class StartError(ValorError):
    """A process did not become ready; the message has its name and the end of its log."""


def bring_up(instance: Instance, plan: instance_setup.Plan, progress: Progress, interruption: Interruption) -> Settings:
    """Start an instance, and enter its initial mode; after an error, such as ``ValorError``, stop everything."""
    with new_instance(instance, progress):
        return _bring_up(instance, plan, progress, interruption)


@contextlib.contextmanager
def new_instance(instance: Instance, progress: Progress | None) -> Iterator[None]:
    """A context that brings up an instance, which an error stops. Raises ``ValorError``: it is up already."""
    require_descriptors()
    with instance_setup.private_files(), instance_setup.changing(instance):
        require_down(instance)
        if shutdown.take_down(instance) and progress is not None:
            progress.done("removed the processes and files of a crashed instance")
        with undone(partial(shutdown.take_down, instance), progress):
            yield


@contextlib.contextmanager
def undone(undo: Callable[[], object], progress: Progress | None) -> Iterator[None]:
    """Call ``undo`` after any error of the block; a ``ValorError`` of ``undo`` is raised together with that error."""
    try:
        yield
    except BaseException as error:
        if progress is not None:
            progress.clear()
        try:
            undo()
        except ValorError as second:
            raise ValorError(f"{error}\nand then: {second}") from error
        raise


@contextlib.contextmanager
def running(
    instance: Instance, request: instance_setup.Request, progress: Progress, interruption: Interruption
) -> Iterator[Settings]:
    """A context in which a system is up; it is stopped at the end in any case."""
    settings = bring_up(instance, instance_setup.plan(request), progress, interruption)
    try:
        yield settings
    finally:
        progress.waiting("shutting down")
        with instance_setup.changing(instance):
            shutdown.take_down(instance)
        progress.done("everything is shut down")


def require_down(instance: Instance) -> None:
    """Raise ``ValorError`` if the instance is up."""
    if supervisor_config.socket_file(instance).exists() and Supervisor(instance).answers():
        advice = f"`valorctl down --instance {instance.name}` first, or name the new one with --instance"
        raise ValorError(f"instance {instance.name!r} is up already; {advice}")


def require_descriptors() -> None:
    """Raise this process's limit of open files; ``ConfigurationError``: the hard limit is too low."""
    allowed, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = supervisor_config.DESCRIPTORS
    if most != resource.RLIM_INFINITY and most < needed:
        raise ConfigurationError(f"a process may open {most} files here (ulimit -Hn); expected at least {needed}")
    if allowed != resource.RLIM_INFINITY and allowed < needed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (needed, most))


def _bring_up(
    instance: Instance, plan: instance_setup.Plan, progress: Progress, interruption: Interruption
) -> Settings:
    processes = plan.profile.table
    with ros_domain.reserve_for(instance, plan.ros_domain) as reservation:  # inherited by supervisord
        domain = reservation.domain if plan.ros_domain is None else plan.ros_domain
        ros_domain.refuse_namesake(instance, domain, plan.settings.namespace)
        settings = instance_setup.make(instance, plan.settings, domain, reservation.domain)
        interruption.check()
        supervisor = supervision.launch(instance, processes, reservation.fileno(), interruption.check)
    with Listener(instance, [process.name for process in processes]) as listener:
        start(supervisor, listener, processes, progress=progress, interruption=interruption)
    if plan.initial_mode is not None:
        enter_initial_mode(instance, supervisor, plan.initial_mode, progress, interruption)
    return settings


def free(processes: Iterable[Process], ready: Collection[str], present: Collection[str]) -> list[Process]:
    """The processes that may start: those they need are ready, and of those they start after, the present ones."""
    return [
        process
        for process in processes
        if all(name in ready for name in process.needs)
        and all(name in ready for name in process.after if name in present)
    ]


def start(
    supervisor: Supervisor | Fleet,
    listener: Listener,
    processes: Sequence[Process],
    *,
    progress: Progress,
    interruption: Interruption,
) -> None:
    """Start each process as soon as it may, and wait until all are ready; raises ``StartError`` if one is not."""
    began = changed = time.monotonic()
    names = [process.name for process in processes]
    ready = set(supervisor.processes()) - set(names)  # running already
    present = ready.union(names)
    waiting, started = list(names), list[str]()
    pids: dict[str, int] = {}
    while waiting:
        interruption.check()
        for process in free(processes, ready, present):
            if process.name not in started:
                supervisor.start(process.name)
                started.append(process.name)
        if not set(waiting).intersection(started):
            raise ValueError(f"processes wait for each other: {', '.join(waiting)}")
        listener.listen(0.05)
        now = time.monotonic()
        infos = supervisor.processes()
        health = {name: judge(infos[name], listener.reports.get(name), now) for name in started}
        for name in started:
            _require_first_run(infos[name], pids, supervisor)
        for name in [name for name in waiting if name in started and health[name].state in ("ready", "degraded")]:
            waiting.remove(name)
            ready.add(name)
            changed = now
            how = "ready" if health[name].state == "ready" else f"degraded: {health[name].detail}"
            progress.done(f"{name} {how} ({now - began:.1f} s)")
        late = [health[name] for name in waiting if name in started]
        if now - changed > READY_TIMEOUT:
            others = f" (nor {', '.join(health.name for health in late[1:])})" if late[1:] else ""
            what = f"{_describe(late[0])} was not ready within {READY_TIMEOUT:g} s{others}"
            raise StartError(f"{what}{supervisor.log_tail(late[0].name)}")
        progress.waiting(f"{int(now - began)} s, waiting for " + ", ".join(_describe(each) for each in late))


def _describe(health: Health) -> str:
    return f"{health.name} ({health.detail})" if health.detail else health.name


def _require_first_run(info: ProcessInfo, pids: dict[str, int], supervisor: Supervisor | Fleet) -> None:
    """Raise ``StartError`` if a process ended since its start: it would end again."""
    first = pids.setdefault(info.name, info.pid) if info.pid else pids.get(info.name)
    if info.state in (ProcessState.EXITED, ProcessState.FATAL, ProcessState.BACKOFF) or info.pid != first:
        why = info.problem if info.state is ProcessState.FATAL else f"ended, {supervisor.last_end(info)}"
        raise StartError(f"{info.name} did not start: {why}{supervisor.log_tail(info.name)}")


def enter_initial_mode(
    instance: Instance, supervisor: Supervisor | Fleet, mode: str, progress: Progress, interruption: Interruption
) -> None:
    """Bring the robot to a control mode; raises ``StartError`` with the end of the VRC's log."""
    began = time.monotonic()
    progress.waiting(f"waiting for control mode {mode}")
    while not (change := control_mode.change(instance, mode, check=interruption.check)).reached:
        if change.current not in (PREPARING, UNREPORTED) or time.monotonic() - began > PREPARATION_TIMEOUT:
            tail = supervisor.log_tail("valor_ros_controller")
            raise StartError(f"valor_ros_controller: {change.describe()}{tail}")
        progress.waiting(f"waiting for control mode {mode}: {change.reason}")
        interruption.check()
        time.sleep(RETRY_PERIOD)
    progress.done(f"control mode {mode} ({time.monotonic() - began:.1f} s)")


def restart(instance: Instance, name: str, progress: Progress, interruption: Interruption) -> None:
    """Stop a process of a running instance, start it again, and wait until it is ready; raises ``ValorError``."""
    with instance_setup.changing(instance), contextlib.closing(require_up(instance)) as supervisor:
        infos = supervisor.processes()
        if name not in infos:
            raise ValorError(f"service {expected(name, [each for each in BY_NAME if each in infos])}")
        _stop(supervisor, [BY_NAME[name]], progress)
        with Listener(instance, [name]) as listener:
            start(supervisor, listener, [BY_NAME[name]], progress=progress, interruption=interruption)
        after = supervisor.processes()[name].pid
    progress.done(f"{name} restarted: pid {infos[name].pid or '–'} → {after}")


def reset(instance: Instance, progress: Progress, interruption: Interruption) -> None:
    """Place a simulated robot at its start, in mode stand; raises ``ValorError``: it is not simulated."""
    with instance_setup.changing(instance), contextlib.closing(require_up(instance)) as supervisor:
        present = supervisor.processes()
        if not simulated(instance.settings(), present):
            raise ValorError(f"only a simulated robot can be reset; {BY_HAND}")
        processes = [BY_NAME[name] for name in _WITH_STATE if name in present]
        _stop(supervisor, processes, progress)
        instance.behavior_file.unlink(missing_ok=True)  # or the robot would still be in Fall
        with Listener(instance, [process.name for process in processes]) as listener:
            start(supervisor, listener, processes, progress=progress, interruption=interruption)
        if "valor_ros_controller" in present:
            enter_initial_mode(instance, supervisor, ControlMode.STAND, progress, interruption)


def _stop(supervisor: Supervisor | Fleet, processes: Sequence[Process], progress: Progress) -> None:
    names = [process.name for process in processes]
    progress.waiting(f"stopping {', '.join(names)}")
    supervisor.stop(names, max(process.stop_timeout for process in processes) + shutdown.MARGIN)
