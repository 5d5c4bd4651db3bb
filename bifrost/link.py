"""One daemon's view of another computer: it follows the daemon there and holds the records of that one's nodes."""

from __future__ import annotations

import contextlib
import logging
import time

import msgspec
import zmq

from bifrost import directory as d
from bifrost.clocks import ClockFilter
from bifrost.network import Computer, Network
from bifrost.security import connect, connecting_socket

_log = logging.getLogger("bifrostd")
Change = d.NodeRecord | tuple[int, d.Reason]  # a node is new or another; a node is gone, and why


class Link:
    """Follows the daemon of another computer.

    While that one is out of reach its nodes are out of the table, but remembered: when it is back it is only told what
    has changed meanwhile, and whose nodes are connected to them stay so.

    Attributes:
        computer: the other one.
        reachable: whether its daemon has been heard of within the last seconds.
        nodes: by incarnation, as last heard.
        heard: when that was, monotonic [s].
        clock: of the other one.
    """

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], network: Network, computer: Computer) -> None:
        self.computer = computer
        self.reachable = False
        self.nodes: dict[int, d.NodeRecord] = {}
        self.heard = 0.0
        self.clock = ClockFilter()
        self._ours = network.computer.name
        self._epoch, self._version = 0, -1
        self._next_follow = 0.0
        self.socket = connecting_socket(context, zmq.DEALER, network)
        self.socket.setsockopt(zmq.SNDHWM, 1)  # one word waits for the other to come, not hundreds
        connect(self.socket, computer.daemon, network.daemon_key)

    def check(self) -> list[Change]:
        """Follow on, in time; returns what follows from the other's silence."""
        now = time.monotonic()
        if now >= self._next_follow:
            self._next_follow = now + d.HEARTBEAT_PERIOD
            self._follow()
        if not self.reachable or now - self.heard <= d.NODE_TIMEOUT:
            return []
        self.reachable = False
        _log.warning("bifrostd of %s at %s cannot be reached", self.computer.name, self.computer.daemon)
        return [(incarnation, "unreachable") for incarnation in self.nodes]

    def receive(self) -> list[Change]:
        """Take what the other says; returns what has changed there."""
        changes: list[Change] = []
        while True:
            try:
                content = self.socket.recv(zmq.NOBLOCK)
            except zmq.Again:
                return changes
            try:
                message = d.decode_from_daemon(content)
            except (msgspec.DecodeError, RecursionError):
                continue  # of another version
            self.heard = time.monotonic()
            changes += self._take(message)

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
            # Otherwise something was missed; the next Follow carries our version and brings the table.
            if isinstance(message, d.Gone):
                return [(message.incarnation, message.reason)] if self.nodes.pop(message.incarnation, None) else []
            self.nodes[message.node.incarnation] = message.node
            return [message.node]
        return []

    def _reached(self, before: dict[int, d.NodeRecord]) -> list[Change]:
        """The nodes that are not as in ``before``, which our own nodes have; all, if the other was out of reach."""
        if not self.reachable:
            self.reachable, before = True, {}
            _log.info("bifrostd of %s at %s is there", self.computer.name, self.computer.daemon)
        return [record for incarnation, record in self.nodes.items() if before.get(incarnation) != record]

    def _replace(self, table: d.Table) -> list[Change]:
        before = self.nodes
        self.nodes = {record.incarnation: record for record in table.nodes}
        reason: d.Reason = "lost" if table.epoch == self._epoch else "forgotten"
        self._epoch, self._version = table.epoch, table.version
        gone: list[Change] = [(incarnation, reason) for incarnation in before if incarnation not in self.nodes]
        return gone + self._reached(before)
