"""UDP datagrams by the dozen: with one system call where Linux can (``UDP_SEGMENT``, ``UDP_GRO``), else one by one."""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
import sys
from collections.abc import Sequence

AT_ONCE = 44  # datagrams of 1,450 B that one message of UDP holds
LONGEST = 65536  # [B]
_SEGMENT, _GRO = 103, 104  # linux/udp.h, at the level of IPPROTO_UDP; Python has no names for them
_ROOM = socket.CMSG_SPACE(4)
_WITHOUT = {
    errno.EINVAL,
    errno.EIO,
    errno.EMSGSIZE,
    errno.ENOPROTOOPT,
    errno.EOPNOTSUPP,
}  # of a system, route or device
Address = tuple[str, int]


class Datagrams:
    """Of a socket."""

    def __init__(self, own: socket.socket) -> None:
        """``own``: bound or not, blocking or not."""
        self._socket = own
        self._together = True
        with contextlib.suppress(OSError):
            own.setsockopt(socket.IPPROTO_UDP, _GRO, 1)

    def receive(self) -> tuple[list[bytes], Address]:
        """Some that came together.

        Raises:
            OSError: as of ``socket.recvfrom``.
        """
        data, told, _, address = self._socket.recvmsg(LONGEST, _ROOM)
        for level, kind, value in told:
            if (level, kind) == (socket.IPPROTO_UDP, _GRO):
                size = int.from_bytes(value[:4], sys.byteorder)
                return [data[at : at + size] for at in range(0, len(data), size)], address
        return [data], address

    def send(self, datagrams: Sequence[bytes], to: Address) -> None:
        """Send ``AT_ONCE`` or fewer, all as long as the first but the last, which may be shorter.

        Raises:
            OSError: as of ``socket.sendto``; those that were not sent are lost.
        """
        if self._together and len(datagrams) > 1:
            size = struct.pack("=H", len(datagrams[0]))
            try:
                self._socket.sendmsg(datagrams, [(socket.IPPROTO_UDP, _SEGMENT, size)], 0, to)
                return
            except OSError as error:
                if error.errno not in _WITHOUT:
                    raise
                self._together = False
        for each in datagrams:
            self._socket.sendto(each, to)
