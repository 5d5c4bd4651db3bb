"""Cutting connections of another process, as a broken cable or a peer that resets them would."""

from __future__ import annotations

import ctypes
import os
import socket

import psutil

_GETFD = 438  # pidfd_getfd(2), the same number on every architecture; Linux 5.6
_libc = ctypes.CDLL(None, use_errno=True)


def cut(pid: int) -> int:
    """Shut every TCP connection of a process down, in both directions; returns how many.

    Raises:
        PermissionError: this user may not reach into it.
    """
    process = os.pidfd_open(pid)
    try:
        connections = psutil.Process(pid).net_connections("tcp")
        return sum(_shut(process, each.fd) for each in connections if each.status == psutil.CONN_ESTABLISHED)
    finally:
        os.close(process)


def _shut(process: int, number: int) -> bool:
    copy = _libc.syscall(_GETFD, process, number, 0)
    if copy < 0:
        if ctypes.get_errno() == 1:  # EPERM
            raise PermissionError("not allowed to reach into another process' connections")
        return False  # closed meanwhile
    with socket.socket(fileno=copy) as connection:
        try:
            connection.shutdown(socket.SHUT_RDWR)
        except OSError:  # it has just ended
            return False
    return True
