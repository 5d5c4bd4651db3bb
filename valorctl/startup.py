"""``up``: from nothing to an instance in which every process has said that it is ready, or back to nothing."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

from valor_common.errors import ValorError
from valor_common.instance import Instance, Settings
from valor_common.processes import BY_NAME, Process
from valorctl import instance_setup, leftovers, shutdown, status, supervision, supervisor_config
from valorctl.console import Progress
from valorctl.health import Health, Listener, judge
from valorctl.interruption import Interruption
from valorctl.supervision import ProcessInfo, ProcessState, Supervisor

# For each wave of processes [s]. One that ends is noticed at once; this is for those that hang on a busy computer.
READY_TIMEOUT = 120.0
_TAIL_LINES = 12


class StartError(ValorError):
    """A process did not become ready: its name, and the last lines of its log."""


def bring_up(instance: Instance, plan: instance_setup.Plan, progress: Progress, interruption: Interruption) -> Settings:
    """Bring an instance up to its initial mode.

    Returns:
        The settings it runs with.

    Raises:
        ValorError: it is up already, or did not come up; then nothing of it is left.
    """  # fmt: skip
    with instance_setup.changing(instance):
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


def refuse_if_up(instance: Instance) -> None:
    """Raise ``ValorError`` if the instance is up."""
    if supervisor_config.socket_file(instance).exists() and Supervisor(instance).answers():
        raise ValorError(
            f"instance {instance.name!r} is up already; `valorctl down` first, "
            "or give the new one another name with --instance"
        )


def _bring_up(
    instance: Instance, plan: instance_setup.Plan, progress: Progress, interruption: Interruption
) -> Settings:
    processes = plan.profile.table
    settings = instance_setup.make(instance, plan.settings)
    interruption.check()
    environment = supervisor_config.environment(instance, sys.executable, os.environ)
    supervisor = supervision.launch(instance, processes, environment, interruption.check)
    with Listener(instance, [process.name for process in processes]) as listener:
        for wave in waves(processes):
            _start_wave(instance, supervisor, listener, wave, progress=progress, interruption=interruption)
    if plan.initial_mode is not None:
        _enter_initial_mode(instance, plan.initial_mode, progress, interruption)
    return settings


def waves(processes: Sequence[Process]) -> list[list[Process]]:
    """Groups to be started one after the other: a process stands in the first group after all that it waits for."""
    names = {process.name for process in processes}
    waiting, started, groups = list(processes), set[str](), list[list[Process]]()
    while waiting:
        group = [p for p in waiting if started.issuperset(p.needs) and started.issuperset(names.intersection(p.after))]
        if not group:
            raise ValueError(f"processes need each other: {', '.join(process.name for process in waiting)}")
        groups.append(group)
        started.update(process.name for process in group)
        waiting = [process for process in waiting if process not in group]
    return groups


def _start_wave(
    instance: Instance,
    supervisor: Supervisor,
    listener: Listener,
    wave: Iterable[Process],
    *,
    progress: Progress,
    interruption: Interruption,
) -> None:
    """Start processes side by side, and wait until each is ready."""  # fmt: skip
    began = time.monotonic()
    names = [process.name for process in wave]
    for name in names:
        supervisor.start(name)
    waiting = list(names)
    pids: dict[str, int] = {}
    while waiting:
        interruption.check()
        listener.listen(0.05)
        now = time.monotonic()
        infos = supervisor.processes()
        health = {name: judge(infos[name], listener.words.get(name), now) for name in waiting}
        for name in names:
            _require_first_run(instance, infos[name], pids)
        for name in list(waiting):
            if health[name].state == "ready":
                waiting.remove(name)
                progress.done(f"{name} ready ({now - began:.1f} s)")
        if now - began > READY_TIMEOUT:
            raise _not_ready(instance, [health[name] for name in waiting])
        progress.waiting(f"{int(now - began)} s, waiting for " + ", ".join(_describe(health[n]) for n in waiting))


def _describe(health: Health) -> str:
    return f"{health.name} ({health.detail})" if health.detail else health.name


def _require_first_run(instance: Instance, info: ProcessInfo, pids: dict[str, int]) -> None:
    """A process that ends while the instance comes up will do so again: fail with its words now."""
    first = pids.setdefault(info.name, info.pid) if info.pid else pids.get(info.name)
    if info.state in (ProcessState.EXITED, ProcessState.FATAL, ProcessState.BACKOFF) or info.pid != first:
        why = info.problem if info.state is ProcessState.FATAL else f"ended with exit status {info.exit_status}"
        raise StartError(f"{info.name} did not start: {why}{log_tail(instance, info.name)}")


def _not_ready(instance: Instance, late: Sequence[Health]) -> StartError:
    first = late[0]
    others = f" (nor {', '.join(health.name for health in late[1:])})" if late[1:] else ""
    return StartError(
        f"{_describe(first)} was not ready within {READY_TIMEOUT:g} s{others}{log_tail(instance, first.name)}"
    )


def log_tail(instance: Instance, name: str) -> str:
    """The last lines of a process' log, to be put behind an error's text."""
    file = log_file(instance, name)
    try:
        lines = file.read_text(errors="replace").splitlines()[-_TAIL_LINES:]
    except OSError:
        return ""
    return "".join(f"\n  {line}" for line in [f"{file}:", *lines]) if lines else f" (its log {file} is empty)"


def log_file(instance: Instance, name: str) -> Path:
    """What a process printed."""
    return instance.logs / f"{name}.log"


def _enter_initial_mode(instance: Instance, mode: str, progress: Progress, interruption: Interruption) -> None:
    from valorctl import control_mode

    began = time.monotonic()
    progress.waiting(f"waiting for control mode {mode}")
    change = control_mode.change(instance, mode, check=interruption.check)
    if not change.reached:
        raise StartError(f"valor_ros_controller: {change.describe()}{log_tail(instance, 'valor_ros_controller')}")
    progress.done(f"control mode {mode} ({time.monotonic() - began:.1f} s)")


def restart(instance: Instance, name: str, progress: Progress, interruption: Interruption) -> None:
    """Stop a process of a running instance, start it anew, and wait until the new one is ready.

    Raises:
        ValorError: the instance is not up, there is no such process, or the new one did not become ready.
    """
    with instance_setup.changing(instance):
        supervisor = status.require_up(instance)
        infos = supervisor.processes()
        if name not in infos:
            known = [each for each in BY_NAME if each in infos]
            raise ValorError(f"service {name!r}: expected one of {', '.join(known)}")
        before = infos[name].pid
        progress.waiting(f"stopping {name}")
        supervisor.stop([name], BY_NAME[name].stop_timeout + shutdown.MARGIN)
        with Listener(instance, [name]) as listener:
            _start_wave(instance, supervisor, listener, [BY_NAME[name]], progress=progress, interruption=interruption)
        after = supervisor.processes()[name].pid
    progress.done(f"{name} restarted: pid {before or '–'} → {after}")
