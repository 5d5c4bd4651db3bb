"""Priority of control loops over other work: nice values on hardware, real time, cores, and time slices.

Slices need no privileges: threads with short ones get the core sooner, threads with long ones interrupt no other.
"""

import contextlib
import ctypes
import os
import platform
import struct
import threading
from collections.abc import Callable
from pathlib import Path

from valor.common.processes import Cores, Turns

_AUTOGROUP = Path("/proc/self/autogroup")
SHORT_TURN = 0.0001  # [s]: the minimum that Linux grants
BACKGROUND_NICENESS = 5
# sched_setattr(2), which Python and some C libraries lack; linux/sched/types.h: struct sched_attr.
_SET_ATTRIBUTES = {"x86_64": 314, "aarch64": 274, "armv7l": 380}
_ATTRIBUTES = struct.Struct("=IIQiIQQQII")


def take_priority(niceness: int) -> None:
    """Set a negative nice value, if the system grants it."""
    if niceness >= 0:
        return
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    # Linux divides the processor among sessions first, and only within a session by nice values (sched(7), autogroup).
    with contextlib.suppress(OSError, ValueError):
        if int(_AUTOGROUP.read_text().split()[-1]) > niceness:
            _AUTOGROUP.write_text(str(niceness))


def take_turns(turns: Turns) -> None:
    """Set the time slice of the calling thread and of all threads that it starts afterwards.

    Linux 6.12 and later gives the core at once to a waking thread with a shorter slice; earlier versions ignore it. A
    ``background`` thread does not interrupt others when it wakes, and gets a third of their share under contention.
    """
    if turns == "background":
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        if (lacking := BACKGROUND_NICENESS - os.getpriority(os.PRIO_PROCESS, 0)) > 0:
            os.nice(lacking)
    elif turns == "short" and (number := _SET_ATTRIBUTES.get(platform.machine())) is not None:
        niceness = os.getpriority(os.PRIO_PROCESS, 0)
        runtime = round(SHORT_TURN * 1e9)
        attributes = _ATTRIBUTES.pack(_ATTRIBUTES.size, os.SCHED_OTHER, 0, niceness, 0, runtime, 0, 0, 0, 0)
        ctypes.CDLL(None).syscall(number, 0, attributes, 0)


def own_core() -> int | None:
    """The core reserved for a control loop, among those that this process may use; None: there is only one core."""
    cores = os.sched_getaffinity(0)
    return max(cores) if len(cores) > 1 else None


def take_cores(cores: Cores) -> int | None:
    """Restrict the calling thread, and all that it starts, to the control loop's core or to the others.

    Returns the control loop's core; None if there is only one core or the system does not grant it.
    """
    core = own_core()
    if core is None:
        return None
    if cores != "any":
        mine = {core} if cores == "own" else os.sched_getaffinity(0) - {core}
        try:
            os.sched_setaffinity(0, mine)
        except OSError:
            return None
    return core


def take_real_time(priority: int) -> bool:
    """Schedule the calling thread in real time (SCHED_FIFO, priority 2 to 99; 0: no change); whether that was granted.

    The other threads of the process get one priority less: the loop's messages wake the encrypting thread, which would
    otherwise often take its core. The kernel limits a loop that never rests (sched_rt_runtime_us).
    """
    if priority <= 0:
        return False
    own = threading.get_native_id()
    try:
        os.sched_setscheduler(own, os.SCHED_FIFO, os.sched_param(priority))
        for thread in map(int, os.listdir("/proc/self/task")):
            if thread != own:
                with contextlib.suppress(ProcessLookupError):  # it has just ended
                    os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority - 1))
    except PermissionError:
        return False
    return True


def granted(real_time: int, niceness: int) -> tuple[bool, bool]:
    """Return whether this user may set a real-time priority, and a nice value; tried in a temporary thread."""
    attempts: tuple[Callable[[], None], ...] = (
        lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(real_time)),
        lambda: os.setpriority(os.PRIO_PROCESS, 0, niceness),  # Linux: of the calling thread
    )
    done = [False, False]

    def attempt() -> None:
        for i, each in enumerate(attempts):
            with contextlib.suppress(PermissionError):
                each()
                done[i] = True

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    return done[0], done[1]
