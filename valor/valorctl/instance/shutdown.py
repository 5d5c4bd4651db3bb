"""``down``: stop all processes of an instance in any state, remove its files except logs and bags, and verify that.

Processes are found by their environment, also if their supervisord was killed. A shell that joined the instance with
``valorctl env`` lacks the marker and is not affected.
"""

import contextlib
import os
import shutil
import signal
import time
from collections.abc import Iterable
from pathlib import Path

import psutil

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.processes import BY_NAME
from valor.valorctl.instance import supervisor_config
from valor.valorctl.instance.running import supervised_processes
from valor.valorctl.instance.supervision import Supervisor, SupervisorError

MARGIN = 3.0  # for supervisord, in addition to the stop timeout of a process [s]
_STOP_TIMEOUT = max(process.stop_timeout for process in BY_NAME.values()) + MARGIN
# Stopped last, so that the other processes can still send their last messages.
_LAST = frozenset(need for process in BY_NAME.values() for need in process.needs)


def processes_of(instance: Instance) -> list[psutil.Process]:
    """The processes of one instance."""
    return [process.process for process in supervised_processes(instance)]


def terminate(processes: Iterable[psutil.Process], timeout: float) -> None:
    """Send SIGTERM, after ``timeout`` [s] SIGKILL; raises ``ValorError`` with processes that do not end."""
    waiting = list(processes)
    for process in waiting:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.terminate()
            process.send_signal(signal.SIGCONT)  # a stopped process does not handle SIGTERM
    waiting = wait_gone(waiting, timeout)
    for process in waiting:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.kill()
    if waiting := wait_gone(waiting, 5.0):
        raise ValorError(f"these processes do not end: {', '.join(str(process.pid) for process in waiting)}")


def wait_gone(processes: Iterable[psutil.Process], timeout: float) -> list[psutil.Process]:
    """Wait up to ``timeout`` [s] for processes to end, or to be zombies; returns those that still run."""
    deadline = time.monotonic() + timeout
    waiting = list(processes)
    while (waiting := [process for process in waiting if _runs(process)]) and time.monotonic() < deadline:
        time.sleep(0.02)
    return waiting


def _runs(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def files_of(instance: Instance) -> list[Path]:
    """The files of an instance that exist only while it is up."""
    candidates = [
        instance.settings_file,
        instance.network_file,
        instance.keys,
        instance.owners,
        instance.behavior_file,
        instance.operator_token,
        supervisor_config.config_file(instance),
        supervisor_config.pid_file(instance),
        *instance.folder.glob(f"*{instance.network_file.stem}.*.nodes*"),  # left by a killed bifrostd
        *instance.folder.glob("supervisor.sock*"),
    ]
    return [file for file in candidates if os.path.lexists(file)]


def take_down(instance: Instance) -> bool:
    """Stop an instance and remove its files; returns whether there was any. Raises ``ValorError``: what remains."""
    processes = processes_of(instance)
    if not processes and not files_of(instance):
        return False
    if processes:
        with contextlib.suppress(SupervisorError):  # the processes are terminated below
            _stop_in_order(Supervisor(instance), processes)
        terminate(processes_of(instance), _STOP_TIMEOUT)
    for file in files_of(instance):
        if file.is_dir():
            shutil.rmtree(file)
        else:
            file.unlink(missing_ok=True)
    left = [f"process {process.pid}" for process in processes_of(instance)]
    left += [str(file) for file in files_of(instance)]
    if left:
        raise ValorError(f"still there after down: {', '.join(left)}")
    return True


def _stop_in_order(supervisor: Supervisor, processes: list[psutil.Process]) -> None:
    names = set(supervisor.processes())
    supervisor.stop(names - _LAST, _STOP_TIMEOUT)
    supervisor.stop(names & _LAST, _STOP_TIMEOUT)
    supervisor.shutdown()
    deadline = time.monotonic() + MARGIN
    # supervisord acts once a second, and at every request.
    while supervisor.answers() and time.monotonic() < deadline:
        time.sleep(0.01)
    wait_gone(processes, MARGIN)
