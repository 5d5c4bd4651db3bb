"""``down``: from whatever there is of an instance to nothing but its logs and bags, and that verified."""

from __future__ import annotations

import contextlib
import time

import psutil

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.processes import BY_NAME
from valor.valorctl import leftovers
from valor.valorctl.supervision import Supervisor, SupervisorError

MARGIN = 3.0  # for supervisord itself, on top of what a process may take [s]
_STOP_TIMEOUT = max(process.stop_timeout for process in BY_NAME.values()) + MARGIN
# Stopped after all others, so that these can still say goodbye.
_LAST = frozenset(need for process in BY_NAME.values() for need in process.needs)


def take_down(instance: Instance) -> bool:
    """Stop everything of an instance and remove what it has only while it is up.

    Works whatever state it is in: up, half up, its supervisor killed.

    Returns:
        Whether there was anything.

    Raises:
        ValorError: something of it is still there; says what.
    """
    processes = leftovers.processes_of(instance)
    if not processes and not leftovers.files_of(instance):
        return False
    shared_memory = leftovers.shared_memory_of(processes)
    if processes:
        with contextlib.suppress(SupervisorError):  # its processes are ended one by one below
            _stop_in_order(Supervisor(instance), processes)
        leftovers.terminate(leftovers.processes_of(instance), _STOP_TIMEOUT)
    leftovers.remove_shared_memory(shared_memory)
    leftovers.remove_files(instance)
    _verify(instance)
    return True


def _stop_in_order(supervisor: Supervisor, processes: list[psutil.Process]) -> None:
    names = set(supervisor.processes())
    supervisor.stop(names - _LAST, _STOP_TIMEOUT)
    supervisor.stop(names & _LAST, _STOP_TIMEOUT)
    supervisor.shutdown()
    deadline = time.monotonic() + MARGIN
    # supervisord looks around once a second, and whenever it is spoken to.
    while supervisor.answers() and time.monotonic() < deadline:
        time.sleep(0.01)
    leftovers.wait_gone(processes, MARGIN)


def _verify(instance: Instance) -> None:
    """Without a process there is no open port either, so those need no look of their own."""
    left = [f"process {process.pid}" for process in leftovers.processes_of(instance)]
    left += [str(file) for file in leftovers.files_of(instance)]
    if left:
        raise ValorError(f"still there after down: {', '.join(left)}")
