"""How the kernel gives a thread its turns on a core: sched_getattr(2), which Python does not have."""

from __future__ import annotations

import ctypes
import os
import struct
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

_GET_ATTRIBUTES = {"x86_64": 315, "aarch64": 275}
_ATTRIBUTES = struct.Struct("=IIQiIQQQII")


class Turns(NamedTuple):
    policy: int
    niceness: int
    length: int  # [ns]; 0: this Linux does not tell


def turns(thread: int = 0) -> Turns:
    """Those of a thread; 0: the calling one."""
    raw = ctypes.create_string_buffer(_ATTRIBUTES.size)
    number = _GET_ATTRIBUTES[os.uname().machine]
    assert ctypes.CDLL(None).syscall(number, thread, raw, len(raw), 0) == 0
    _, policy, _, niceness, _, length, *_ = _ATTRIBUTES.unpack(raw.raw)
    return Turns(policy, niceness, length)


def after(call: Callable[[], object]) -> Turns:
    """Those of a thread that has called something, and ended."""
    with ThreadPoolExecutor(1) as threads:
        threads.submit(call).result()
        return threads.submit(turns).result()


def known() -> bool:
    """Return whether this machine's call is known here."""
    return os.uname().machine in _GET_ATTRIBUTES
