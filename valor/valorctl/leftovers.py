"""Everything of an instance that the machine holds: processes, shared memory, files. Finds it, and takes it away.

Processes are found by their environment, so that those whose supervisord was killed are found too. A shell that joined
the instance with ``valorctl env`` lacks the marker and is left alone.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import psutil

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.processes import SUPERVISED
from valor.valorctl import supervisor_config

_SHARED_MEMORY = re.compile(r"/dev/shm/\S*(?:fastrtps|fastdds)\S*")


@dataclass(frozen=True)
class Supervised:
    """A process that was started under some instance's supervisord, or is it."""

    process: psutil.Process
    home: str
    instance: str
    command: str


def supervised_processes(instance: Instance | None = None) -> list[Supervised]:
    """Those of one instance, or of all, of all users that we may look at."""
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


def processes_of(instance: Instance) -> list[psutil.Process]:
    """Those of one instance."""
    return [process.process for process in supervised_processes(instance)]


def shared_memory_of(processes: Iterable[psutil.Process]) -> set[Path]:
    """Fast DDS' shared-memory files that processes hold in their address space.

    None as long as ``FASTDDS_BUILTIN_TRANSPORTS`` says UDPv4; a profile or a shell may say otherwise.
    """
    files: set[Path] = set()
    for process in processes:
        with contextlib.suppress(OSError):
            maps = Path(f"/proc/{process.pid}/maps").read_text()
            files.update(Path(name) for name in _SHARED_MEMORY.findall(maps))
    return files


def remove_shared_memory(files: Iterable[Path]) -> None:
    """Remove files that nobody holds any more."""
    files = {file for file in files if file.exists()}
    if files:
        for file in files - shared_memory_of(psutil.process_iter()):
            file.unlink(missing_ok=True)


def terminate(processes: Iterable[psutil.Process], timeout: float) -> None:
    """SIGTERM, and SIGKILL to those that are still there after ``timeout`` [s].

    Raises:
        ValorError: something outlives even that; names it.
    """
    waiting = list(processes)
    for process in waiting:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.terminate()
            process.send_signal(signal.SIGCONT)  # a stopped process would not hear of it
    waiting = wait_gone(waiting, timeout)
    for process in waiting:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.kill()
    if waiting := wait_gone(waiting, 5.0):
        raise ValorError(f"these processes do not end: {', '.join(str(process.pid) for process in waiting)}")


def wait_gone(processes: Iterable[psutil.Process], timeout: float) -> list[psutil.Process]:
    """Wait for processes to end; returns those that have not within ``timeout`` [s].

    A zombie has ended: not every container's first process collects orphans.
    """
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
    """What an instance has on disk only while it is up."""
    candidates = [
        instance.settings_file,
        instance.network_file,
        instance.keys,
        instance.owners,
        instance.behavior_file,
        instance.operator_token,
        instance.viewer_token,
        instance.viewing_file,
        supervisor_config.config_file(instance),
        supervisor_config.pid_file(instance),
        *instance.folder.glob(f"*{instance.network_file.stem}.*.nodes*"),  # what a killed bifrostd has left
        *instance.folder.glob("supervisor.sock*"),
    ]
    return [file for file in candidates if os.path.lexists(file)]


def remove_files(instance: Instance) -> None:
    """Remove them; logs and bags stay."""
    for file in files_of(instance):
        if file.is_dir():
            shutil.rmtree(file)
        else:
            file.unlink(missing_ok=True)
