"""UDP sockets of a link endpoint.

The operator's end has the robot end's addresses. The robot's end sends to the source of the latest sealed datagram and
answers a hello to its source, so that it needs no address and the operator's may change.
"""

import contextlib
import selectors
import socket
from collections.abc import Sequence

from valor.common.errors import ConfigurationError
from valor.link.endpoint import Channel, LinkEndpoint
from valor.link.session import CONFIRMATION, SEALED

LONGEST = 2048  # datagram [B]
MOST = 64  # datagrams received on one channel in one turn
Address = tuple[str, int]


class UdpTransport:
    """Receives datagrams for an endpoint and sends those due. For one thread."""

    def __init__(self, end: LinkEndpoint, *, own: Sequence[Address] = (), other: Sequence[Address] = ()) -> None:
        """Open a socket for each channel, slow and fast. Raises ConfigurationError: a port is in use.

        ``own``: addresses to bind, any by default; ``other``: of the other end, by default those from which it sends.
        """
        self._end = end
        self._selector = selectors.DefaultSelector()
        self._sockets: dict[Channel, socket.socket] = {}
        self._peers: dict[Channel, Address] = {Channel(number): address for number, address in enumerate(other)}
        self._fixed = bool(other)
        self._hello_sources: dict[Channel, Address] = {}
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
        """Wait for a datagram, at most ``longest`` [s]."""
        self._selector.select(longest)

    def turn(self, now: float) -> None:
        """Receive datagrams and send due ones; ``now``: monotonic [s]."""
        for channel, each in self._sockets.items():
            for _ in range(MOST):
                try:
                    data, address = each.recvfrom(LONGEST)
                except OSError:  # no more datagrams, or an ICMP error: the peer is not reachable
                    break
                if self._end.receive(data, channel, now):
                    proved = data[0] in (SEALED, CONFIRMATION) and not self._fixed
                    (self._peers if proved else self._hello_sources)[channel] = address
        for channel, data in self._end.turn(now):
            source = None if self._fixed or data[0] == SEALED else self._hello_sources.get(channel)
            to = source or self._peers.get(channel)
            if to is not None:
                with contextlib.suppress(OSError):  # counts as lost, like any datagram
                    self._sockets[channel].sendto(data, to)

    def close(self) -> None:
        """Close the sockets."""
        self._selector.close()
        for each in self._sockets.values():
            each.close()
