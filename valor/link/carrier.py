"""An end on its two UDP sockets.

The operator's end knows where the robot's is; the robot's sends to where the newest sealed datagram came from, and
answers a hello where that came from, so that it knows no address and an operator may move.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
from collections.abc import Sequence

from valor.common.errors import ConfigurationError
from valor.link.end import Channel, End
from valor.link.session import SEALED

LONGEST = 2048  # of a datagram [B]
MOST = 64  # datagrams of a channel in one turn
Address = tuple[str, int]


class Carrier:
    """Takes datagrams to an end and away from it. From one thread."""

    def __init__(self, end: End, *, own: Sequence[Address] = (), other: Sequence[Address] = ()) -> None:
        """Open a socket a channel, slow and fast.

        Args:
            end: of the link.
            own: where to listen; none: anywhere.
            other: where the other end is; none: it makes itself known.

        Raises:
            ConfigurationError: a port is another's.
        """
        self._end = end
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

    def wait(self, longest: float) -> None:
        """Until something comes, at most so long [s]."""
        self._selector.select(longest)

    def turn(self, now: float) -> None:
        """Take what has come, send what is due; ``now``: monotonic [s]."""
        for channel in Channel:
            for _ in range(MOST):
                try:
                    data, address = self._sockets[channel].recvfrom(LONGEST)
                except OSError:  # nothing more; or nobody is there, as ICMP tells
                    break
                if self._end.receive(data, channel, now):
                    (self._peers if data[0] == SEALED and not self._fixed else self._callers)[channel] = address
        for channel, data in self._end.turn(now):
            caller = None if self._fixed or data[0] == SEALED else self._callers.get(channel)
            to = caller or self._peers.get(channel)
            if to is not None:
                with contextlib.suppress(OSError):  # it is lost, as others are
                    self._sockets[channel].sendto(data, to)

    def close(self) -> None:
        """Give back the sockets."""
        self._selector.close()
        for each in self._sockets.values():
            each.close()
