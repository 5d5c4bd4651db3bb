"""An end on its two UDP sockets.

The operator's end knows where the robot's is; the robot's sends to where the newest sealed datagram came from, and
answers a hello where that came from, so that it knows no address and an operator may move.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import time
from collections.abc import Iterator, Sequence
from typing import Protocol

from valor.common.errors import ConfigurationError
from valor.link.bulk.lane import BULK
from valor.link.datagrams import Address, Datagrams
from valor.link.end import Channel, End
from valor.link.errors import SealError
from valor.link.session import SEALED

LONGEST = 2048  # of a datagram of the slow channel [B]
MOST = 64  # of them in one turn
LONG = 0.004  # of a processor that datagrams of the fast channel may take in one turn [s]
BUFFER = 4 * 2**20  # of the fast channel's sockets; the system may grant less [B]
_BULK = bytes((BULK,))


class Things(Protocol):
    """An end's part of what travels on the fast channel alone."""

    @property
    def busy(self) -> bool:
        """Whether more waits to be sent than one turn takes."""

    def receive(self, data: bytes, now: float) -> None:
        """A datagram of the other end's.

        Raises:
            SealError: it is none.
        """

    def turn(self, now: float, all_heard: bool, /) -> Iterator[list[bytes]]:
        """Datagrams to send now, together as ``Datagrams.send`` takes them; what is not taken off is offered again.

        Args:
            now: monotonic [s].
            all_heard: nothing that has come waits to be received.
        """


class Carrier:
    """Takes datagrams to an end and away from it. From one thread."""

    def __init__(
        self, end: End, *, own: Sequence[Address] = (), other: Sequence[Address] = (), things: Things | None = None
    ) -> None:
        """Open a socket a channel, slow and fast.

        Args:
            end: of the link.
            own: where to listen; none: anywhere.
            other: where the other end is; none: it makes itself known.
            things: of the fast channel; None: there are none.

        Raises:
            ConfigurationError: a port is another's.
        """
        self._end, self._things = end, things
        self._selector = selectors.DefaultSelector()
        self._sockets: dict[Channel, socket.socket] = {}
        self._peers: dict[Channel, Address] = {Channel(place): address for place, address in enumerate(other)}
        self._fixed = bool(other)
        self._callers: dict[Channel, Address] = {}
        for channel in Channel:
            each = self._sockets[channel] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            each.setblocking(False)
            if own:
                try:
                    each.bind(own[channel])
                except OSError as error:
                    self.close()
                    raise ConfigurationError(f"UDP port {own[channel]}: {error.strerror}") from None
            self._selector.register(each, selectors.EVENT_READ, channel)
        for which in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            self._sockets[Channel.FAST].setsockopt(socket.SOL_SOCKET, which, BUFFER)
        self._fast = Datagrams(self._sockets[Channel.FAST])

    def wait(self, longest: float) -> None:
        """Until something comes, at most so long [s]."""
        self._selector.select(0.0 if self._things is not None and self._things.busy else longest)

    def turn(self, now: float) -> None:
        """Take what has come, send what is due; ``now``: monotonic [s]."""
        for _ in range(MOST):
            try:
                data, address = self._sockets[Channel.SLOW].recvfrom(LONGEST)
            except OSError:  # nothing more; or nobody is there, as ICMP tells
                break
            self._hear(Channel.SLOW, data, address, now)
        until = time.thread_time() + LONG
        while (more := self._take(now)) and time.thread_time() < until:
            pass
        for channel, data in self._end.turn(now):
            caller = None if self._fixed or data[0] == SEALED else self._callers.get(channel)
            to = caller or self._peers.get(channel)
            if to is not None:
                with contextlib.suppress(OSError):  # it is lost, as others are
                    self._sockets[channel].sendto(data, to)
        self._give(now, not more)

    def _take(self, now: float) -> bool:
        """Datagrams of the fast channel; whether there were any."""
        try:
            together, address = self._fast.receive()
        except OSError:  # as of the slow one
            return False
        for data in together:
            self._hear(Channel.FAST, data, address, now)
        return True

    def _hear(self, channel: Channel, data: bytes, address: Address, now: float) -> None:
        if self._things is not None and channel is Channel.FAST and data[:1] == _BULK:
            try:
                self._things.receive(data, now)
            except SealError as error:
                self._end.refuse(error)
        elif self._end.receive(data, channel, now):
            (self._peers if data[0] == SEALED and not self._fixed else self._callers)[channel] = address

    def _give(self, now: float, all_heard: bool) -> None:
        to = self._peers.get(Channel.FAST)
        if self._things is None or to is None:
            return
        for together in self._things.turn(now, all_heard):
            try:
                self._fast.send(together, to)
            except OSError:  # the buffer is full, or nobody is there
                return

    def close(self) -> None:
        """Give back the sockets."""
        self._selector.close()
        for each in self._sockets.values():
            each.close()
