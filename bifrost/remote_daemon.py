"""A daemon's copy of another computer's nodes, kept by following the daemon there."""

import contextlib
import logging
import time

import zmq

from bifrost import directory as d
from bifrost.clocks import ClockFilter
from bifrost.network import Computer, Network
from bifrost.security import connect, connecting_socket

_log = logging.getLogger("bifrostd")
Change = d.NodeRecord | tuple[int, d.Reason]  # a new or changed node; or an ended node, with the reason


class RemoteDaemon:
    """Follows the daemon of another computer.

    While that daemon is unreachable, its nodes are not in the table, but stored. When it is reachable again, only
    changes are sent, and connections to unchanged nodes persist.
    """

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], network: Network, computer: Computer) -> None:
        self.computer = computer  # of the daemon
        self.reachable = False  # whether a message has been received within the last seconds
        self.nodes: dict[int, d.NodeRecord] = {}  # latest records by incarnation
        self.heard = 0.0  # time of the latest message, monotonic [s]
        self.clock = ClockFilter()  # of the computer
        self._ours = network.computer.name
        self._epoch, self._version = 0, -1
        self._next_follow = 0.0
        self.socket = connecting_socket(context, zmq.DEALER, network)
        self.socket.setsockopt(zmq.SNDHWM, 1)  # queue one message while the daemon is unreachable
        connect(self.socket, computer.daemon, network.daemon_key)

    def check(self) -> list[Change]:
        """Send the periodic Follow; returns the changes if the daemon has timed out."""
        now = time.monotonic()
        if now >= self._next_follow:
            self._next_follow = now + d.HEARTBEAT_PERIOD
            self._follow()
        if not self.reachable or now - self.heard <= d.NODE_TIMEOUT:
            return []
        self.reachable = False
        _log.warning("bifrostd of %s at %s is unreachable", self.computer.name, self.computer.daemon)
        return [(incarnation, "unreachable") for incarnation in self.nodes]

    def receive(self) -> list[Change]:
        """Process received messages; returns the changes of nodes there."""
        changes: list[Change] = []
        for message in d.from_daemon(self.socket):
            self.heard = time.monotonic()
            changes += self._take(message)
        return changes

    def _follow(self) -> None:
        follow = d.Follow(self._ours, self._epoch, self._version, time.monotonic_ns())
        with contextlib.suppress(zmq.Again):
            self.socket.send(d.encode(follow), zmq.NOBLOCK)

    def _take(self, message: d.FromDaemon) -> list[Change]:
        if isinstance(message, d.Table | d.Alive) and message.taken:
            self.clock.add(message.sent, message.taken, time.monotonic_ns())
        if isinstance(message, d.Table):
            return self._replace(message)
        if isinstance(message, d.Alive):
            return self._reached({})
        if isinstance(message, d.Update | d.Gone) and message.epoch == self._epoch:
            if message.version == self._version + 1:
                self._version = message.version
            # Otherwise an update was lost; the reply to the next Follow, with our version, is the table.
            if isinstance(message, d.Gone):
                return [(message.incarnation, message.reason)] if self.nodes.pop(message.incarnation, None) else []
            self.nodes[message.node.incarnation] = message.node
            return [message.node]
        return []

    def _reached(self, before: dict[int, d.NodeRecord]) -> list[Change]:
        """Nodes that differ from ``before``, the state of our nodes; all, if the daemon was unreachable."""
        if not self.reachable:
            self.reachable, before = True, {}
            _log.info("bifrostd of %s at %s is reachable", self.computer.name, self.computer.daemon)
        return [record for incarnation, record in self.nodes.items() if before.get(incarnation) != record]

    def _replace(self, table: d.Table) -> list[Change]:
        before = self.nodes
        self.nodes = {record.incarnation: record for record in table.nodes}
        reason: d.Reason = "lost" if table.epoch == self._epoch else "forgotten"
        self._epoch, self._version = table.epoch, table.version
        gone: list[Change] = [(incarnation, reason) for incarnation in before if incarnation not in self.nodes]
        return gone + self._reached(before)
