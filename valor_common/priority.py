"""How control processes on hardware go before others."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

_AUTOGROUP = Path("/proc/self/autogroup")


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
