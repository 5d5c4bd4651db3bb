"""``up``: from nothing to an instance in which every process has said that it is ready, or back to nothing."""

from __future__ import annotations

import contextlib
import os
import resource
import sys
import time
from collections.abc import Collection, Iterable, Iterator, Sequence

from valor.common.errors import ConfigurationError, ValorError, expected
from valor.common.instance import Instance, Settings
from valor.common.mode_names import PREPARING
from valor.common.processes import BY_NAME, Process
from valor.valorctl import (
    instance_setup,
    leftovers,
    presence,
    ros_domain,
    shutdown,
    supervision,
    supervisor_config,
    viewing,
)
from valor.valorctl.console import Progress
from valor.valorctl.health import Health, Listener, judge
from valor.valorctl.interruption import Interruption
from valor.valorctl.supervision import ProcessInfo, ProcessState, Supervising, Supervisor

# Without another process getting ready [s]. One that ends is noticed at once; this is for those that hang on a busy
# computer.
READY_TIMEOUT = 120.0
PREPARATION_TIMEOUT = 30.0  # [s]
RETRY_PERIOD = 0.5  # [s]
UNTOLD = ""  # in place of the current mode, by a link whose ends have not heard each other yet


class StartError(ValorError):
    """A process did not become ready: its name, and the last lines of its log."""


def bring_up(instance: Instance, plan: instance_setup.Plan, progress: Progress, interruption: Interruption) -> Settings:
    """Bring an instance up to its initial mode.

    Returns:
        The settings it runs with.

    Raises:
        ValorError: it is up already, or did not come up; then nothing of it is left.
    """  # fmt: skip
    require_descriptors()
    with instance_setup.private_files(), instance_setup.changing(instance):
        refuse_if_up(instance)
        if leftovers.processes_of(instance) or leftovers.files_of(instance):
            shutdown.take_down(instance)
            progress.done("cleared what an instance that had crashed left behind")
        try:
            return _bring_up(instance, plan, progress, interruption)
        except BaseException as error:
            progress.clear()
            try:
                shutdown.take_down(instance)
            except ValorError as second:
                raise ValorError(f"{error}\nand then: {second}") from error
            raise


@contextlib.contextmanager
def running(
    instance: Instance, request: instance_setup.Request, progress: Progress, interruption: Interruption
) -> Iterator[Settings]:
    """A system that is up inside and down behind, whatever happens."""
    settings = bring_up(instance, instance_setup.plan(request), progress, interruption)
    try:
        yield settings
    finally:
        progress.waiting("shutting down")
        with instance_setup.changing(instance):
            shutdown.take_down(instance)
        progress.done("everything is shut down")


def refuse_if_up(instance: Instance) -> None:
    """Raise ``ValorError`` if the instance is up."""
    if supervisor_config.socket_file(instance).exists() and Supervisor(instance).answers():
        raise ValorError(
            f"instance {instance.name!r} is up already; `valorctl down --instance {instance.name}` first, "
            "or give the new one another name with --instance"
        )


def require_descriptors() -> None:
    """See that processes may open what they need, this one included.

    Raises:
        ConfigurationError: they may not.
    """
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
    with ros_domain.reserve_for(instance, plan.ros_domain) as reservation:  # from then on supervisord holds it
        domain = reservation.domain if plan.ros_domain is None else plan.ros_domain
        ros_domain.refuse_namesake(instance, domain, plan.settings.namespace)
        settings = instance_setup.make(instance, plan.settings, domain, reservation.domain)
        if plan.viewing is not None:
            viewing.decide(instance, plan.viewing)
        interruption.check()
        environment = supervisor_config.environment(instance, sys.executable, os.environ)
        supervisor = supervision.launch(instance, processes, environment, reservation.fileno(), interruption.check)
    with Listener(instance, [process.name for process in processes]) as listener:
        start(supervisor, listener, processes, progress=progress, interruption=interruption)
    if plan.initial_mode is not None:
        enter_initial_mode(instance, supervisor, plan.initial_mode, progress, interruption)
    return settings


def free(processes: Iterable[Process], ready: Collection[str], present: Collection[str]) -> list[Process]:
    """Those that may start: what they need is ready, and of what they only wait for, what is present at all."""
    return [
        process
        for process in processes
        if all(name in ready for name in process.needs)
        and all(name in ready for name in process.after if name in present)
    ]


def start(
    supervisor: Supervising,
    listener: Listener,
    processes: Sequence[Process],
    *,
    progress: Progress,
    interruption: Interruption,
) -> None:
    """Start processes, each as soon as it may, and wait until all are ready.

    Raises:
        ValorError: one is not; carries its last words.
    """  # fmt: skip
    began = changed = time.monotonic()
    names = [process.name for process in processes]
    ready = set(supervisor.processes()) - set(names)  # those that run already
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
        health = {name: judge(infos[name], listener.words.get(name), now) for name in started}
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
            raise _not_ready(supervisor, late)
        progress.waiting(f"{int(now - began)} s, waiting for " + ", ".join(_describe(each) for each in late))


def _describe(health: Health) -> str:
    return f"{health.name} ({health.detail})" if health.detail else health.name


def _require_first_run(info: ProcessInfo, pids: dict[str, int], supervisor: Supervising) -> None:
    """A process that ends while the instance comes up will do so again: fail with its words now."""
    first = pids.setdefault(info.name, info.pid) if info.pid else pids.get(info.name)
    if info.state in (ProcessState.EXITED, ProcessState.FATAL, ProcessState.BACKOFF) or info.pid != first:
        why = info.problem if info.state is ProcessState.FATAL else f"ended, {supervisor.last_end(info)}"
        raise StartError(f"{info.name} did not start: {why}{supervisor.log_tail(info.name)}")


def _not_ready(supervisor: Supervising, late: Sequence[Health]) -> StartError:
    first = late[0]
    others = f" (nor {', '.join(health.name for health in late[1:])})" if late[1:] else ""
    return StartError(
        f"{_describe(first)} was not ready within {READY_TIMEOUT:g} s{others}{supervisor.log_tail(first.name)}"
    )


def enter_initial_mode(
    instance: Instance, supervisor: Supervising, mode: str, progress: Progress, interruption: Interruption
) -> None:
    """Bring the robot to a control mode.

    Raises:
        ValorError: it is not reached; carries the VRC's last words.
    """
    from valor.valorctl import control_mode

    began = time.monotonic()
    progress.waiting(f"waiting for control mode {mode}")
    change = control_mode.change(instance, mode, check=interruption.check)
    while (
        not change.reached and change.current in (PREPARING, UNTOLD) and time.monotonic() - began < PREPARATION_TIMEOUT
    ):
        progress.waiting(f"waiting for control mode {mode}: {change.reason}")
        interruption.check()
        time.sleep(RETRY_PERIOD)
        change = control_mode.change(instance, mode, check=interruption.check)
    if not change.reached:
        tail = supervisor.log_tail("valor_ros_controller")
        raise StartError(f"valor_ros_controller: {change.describe()}{tail}")
    progress.done(f"control mode {mode} ({time.monotonic() - began:.1f} s)")


def restart(instance: Instance, name: str, progress: Progress, interruption: Interruption) -> None:
    """Stop a process of a running instance, start it anew, and wait until the new one is ready.

    Raises:
        ValorError: the instance is not up, there is no such process, or the new one did not become ready.
    """
    with instance_setup.changing(instance), contextlib.closing(presence.require_up(instance)) as supervisor:
        infos = supervisor.processes()
        if name not in infos:
            known = [each for each in BY_NAME if each in infos]
            raise ValorError(f"service {expected(name, known)}")
        before = infos[name].pid
        progress.waiting(f"stopping {name}")
        supervisor.stop([name], BY_NAME[name].stop_timeout + shutdown.MARGIN)
        with Listener(instance, [name]) as listener:
            start(supervisor, listener, [BY_NAME[name]], progress=progress, interruption=interruption)
        after = supervisor.processes()[name].pid
    progress.done(f"{name} restarted: pid {before or '–'} → {after}")
