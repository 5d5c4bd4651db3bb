"""How control goes before other work: by nice values on hardware, in real time where a loop must not wait, by cores,
and by turns: short ones come sooner, long ones interrupt nobody. Turns need no privileges.

In a simulation a control loop is quicker by a tenth where less of others' work comes and goes in its core's caches.
"""

from __future__ import annotations

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
SHORT_TURN = 0.0001  # [s]: the least that Linux grants
BACKGROUND_NICENESS = 5
# sched_setattr(2), which neither Python nor every C library has; linux/sched/types.h: struct sched_attr.
_SET_ATTRIBUTES = {"x86_64": 314, "aarch64": 274, "armv7l": 380}
_ATTRIBUTES = struct.Struct("=IIQiIQQQII")


def take_priority(niceness: int) -> None:
    """Go before other processes, where that is granted: a robot does not wait until somebody's compiler is done."""
    if niceness >= 0:
        return
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    # Linux shares the processor among sessions first, and only within one by nice values (sched(7), autogroup).
    with contextlib.suppress(OSError, ValueError):
        if int(_AUTOGROUP.read_text().split()[-1]) > niceness:
            _AUTOGROUP.write_text(str(niceness))


def take_turns(turns: Turns) -> None:
    """Say how long the calling thread's turns on a core are to be, and those of all threads it starts from now on.

    Linux (6.12 and later) gives a thread that wakes the core at once if its turns are the shorter ones; with turns as
    long as everybody's it waits until whoever runs has had one, some milliseconds where the timer ticks rarely. Before,
    asking changes nothing.

    Args:
        turns: ``short``; ``background``: takes no core away from others by waking, and a third of what they get where
            all of them want more than there is; ``usual``.
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
    """Of the cores that this process may use, the one that a control loop has to itself; None: there is one only."""
    cores = os.sched_getaffinity(0)
    return max(cores) if len(cores) > 1 else None


def take_cores(cores: Cores) -> int | None:
    """Stay on the core that a control loop has to itself, or off it, with all threads that are started from now on.

    Args:
        cores: which of the two, or any.

    Returns:
        The loop's core; None: nobody has one, for there is one only or the system does not grant it.
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
    """Let the loop of the calling thread wait for nothing but itself, where that is granted (SCHED_FIFO).

    The other threads of the process come one below: what the loop sends wakes the thread that encrypts it, which
    otherwise takes the loop's own core away as often as not. A loop that never rests is kept from taking a core for
    good by the kernel (sched_rt_runtime_us).

    Args:
        priority: of the calling thread, 2 to 99; 0: stay as it is.

    Returns:
        Whether it was granted: to root, and to users with a real-time limit (``ulimit -r``) of that priority.
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
    """Whether a process of this user would get a real-time priority, and a nice value: tried in a thread that ends."""
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
