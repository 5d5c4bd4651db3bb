"""``python -m bifrost.daemon``: the name service of one computer.

It keeps the table of its computer's nodes, follows the daemons of the network's other computers, and pushes every
change to all of its nodes at once. Data never passes through it.
"""

from __future__ import annotations

import errno
import logging
import os
import secrets
import signal
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field

import msgspec
import psutil
import zmq
from zmq.utils.monitor import recv_monitor_message

from bifrost import directory as d
from bifrost.errors import ConfigurationError
from bifrost.grants import DAEMON
from bifrost.keepsake import Keepsake
from bifrost.link import Link
from bifrost.network import Network
from bifrost.security import Gate, listening_socket, new_context

_log = logging.getLogger("bifrostd")
_NOTABLE = 20_000  # change of another clock [ns]
_UNKNOWN = 2**63  # no clock is so far ahead [ns]
_WARNINGS = 100  # of what members may not say, at most
EXIT_CONFIGURATION = 78  # sysexits' EX_CONFIG
EXIT_PORT_TAKEN = 75  # EX_TEMPFAIL: whoever has it may give it back, so that another start is worth while


class PortTakenError(ConfigurationError):
    """Somebody else listens where the daemon should."""


@dataclass
class _Member:
    routing_id: bytes
    descriptor: int  # of its connection
    record: d.NodeRecord
    heard: float
    owner: str  # that its connection has proven it to be; or a member
    counts: list[d.Count] = field(default_factory=list)


@dataclass(frozen=True)
class _Peer:
    """Whom a message came from."""

    routing_id: bytes
    descriptor: int  # of its connection
    owner: str  # that it has proven to be; or a member


@dataclass
class _Follower:
    routing_id: bytes
    heard: float


class Daemon:
    """The table, the socket over which nodes fill and read it, and the links to the other computers' daemons.

    Two versions are counted: of the table that its nodes have, and of its own nodes alone, which followers have.
    """

    def __init__(self, network: Network) -> None:
        self._context = new_context()
        self._grants = network.grants
        if network.owner != self._grants.daemon:
            raise ConfigurationError(f"the key of {DAEMON} is not given: expected BIFROST_OWNERS, the folder it is in")
        self._links: list[Link] = []
        self._keepsake = Keepsake(network.keepsake)
        self._gate = Gate(self._context, network)
        self._socket = listening_socket(self._context, zmq.ROUTER, network)
        self._monitor = self._socket.get_monitor_socket(zmq.EVENT_DISCONNECTED)
        try:
            self._socket.bind(network.computer.daemon)
        except zmq.ZMQError as error:
            self.close()
            text = f"cannot listen on {network.computer.daemon}: {error.strerror}"
            raise (PortTakenError if error.errno == errno.EADDRINUSE else ConfigurationError)(text) from None
        self._members: dict[int, _Member] = {}
        self._followers: dict[str, _Follower] = {}
        self._links = [Link(self._context, network, other) for other in network.others]
        self._poller = zmq.Poller()
        for socket in (self._gate.socket, self._monitor, self._socket, *(link.socket for link in self._links)):
            self._poller.register(socket, zmq.POLLIN)
        self._epoch = secrets.randbits(63)
        self._version = 0
        self._own_version = 0
        self._clocks_told: dict[str, int] = {}
        self._refused = 0
        self._refusal = ""
        self._warned: set[str] = set()
        self._process = psutil.Process()
        self._process.cpu_percent()
        self._started = time.monotonic()
        self._last_check = self._started

    def run_once(self, timeout: float) -> None:
        """Handle what comes within ``timeout`` [s]."""
        ready = dict(self._poller.poll(max(0, int(timeout * 1000))))
        if self._gate.socket in ready:
            self._gate.answer()
        lost = self._disconnected() if self._monitor in ready else []
        if self._socket in ready:
            self._receive()  # what the lost have said before is heard first: most have taken their leave
        for incarnation in lost:
            if incarnation in self._members:
                record = self._members[incarnation].record
                _log.info("node %s (pid %d) went without a word", record.name, record.pid)
                self._drop(incarnation, "lost")
        for link in self._links:
            if link.socket in ready:
                changes = link.receive()
                self._tell_clocks()  # before its nodes, whose stamps are by it
                self._pass_on(changes)
            self._pass_on(link.check())
        self._drop_silent()
        self._keepsake.update(self._version, self._table)

    def _disconnected(self) -> list[int]:
        """The nodes whose connection has ended. One that lives registers again on its next heartbeat."""
        ended = set()
        while self._monitor.poll(0):
            ended.add(recv_monitor_message(self._monitor)["value"])
        return [i for i, member in self._members.items() if member.descriptor in ended]

    def _receive(self) -> None:
        for _ in range(1000):
            try:
                frames = self._socket.recv_multipart(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                return
            if len(frames) != 2:
                self._refused += 1
                continue
            try:
                message = d.decode_to_daemon(frames[1].buffer)
            except (msgspec.DecodeError, RecursionError):
                self._refused += 1  # from a member, but of another version: unheard, it is dropped
                continue
            self._handle(_Peer(frames[0].bytes, int(frames[1].get(zmq.SRCFD)), str(frames[1].get("User-Id"))), message)

    def _handle(self, peer: _Peer, message: d.ToDaemon) -> None:
        now, taken = time.monotonic(), time.monotonic_ns()
        sender, descriptor = peer.routing_id, peer.descriptor
        if isinstance(message, d.Heartbeat):
            member = self._members.get(message.incarnation)
            if member is None:
                self._send(sender, d.Unknown(self._epoch))
                return
            if not self._may_speak_for(member, peer):
                return
            member.heard = now
            member.routing_id, member.descriptor = sender, descriptor
            if message.counts is not None:
                member.counts = message.counts
            if (message.epoch, message.version) == (self._epoch, self._version):
                self._send(sender, d.Alive(self._epoch, self._version))
            else:
                self._send(sender, self._table())
        elif isinstance(message, d.Register):
            known = self._members.get(message.node.incarnation)
            if known is not None and not self._may_speak_for(known, peer):
                return
            node, refusals = message.node.sifted(self._grants, peer.owner)
            for refusal in refusals:
                self._refuse(f"{refusal} (pid {node.pid} on {node.computer}, key of {peer.owner})")
            self._members[node.incarnation] = _Member(sender, descriptor, node, now, peer.owner)
            if known is None or known.record != node:
                self._changed(node)
            if known is None:
                if self._clocks_told:
                    self._send(sender, d.Clocks(self._clocks_told))
                self._send(sender, self._table())
            else:
                self._members[node.incarnation].counts = known.counts
        elif isinstance(message, d.Leave):
            member = self._members.get(message.incarnation)
            if member is not None and self._may_speak_for(member, peer):
                self._drop(message.incarnation, "left")
        elif isinstance(message, d.Follow):
            if peer.owner != self._grants.daemon:
                self._refuse(f"{peer.owner} wants to follow as the daemon of {message.computer}: refused")
                return
            self._followers[message.computer] = _Follower(sender, now)
            if (message.epoch, message.version) == (self._epoch, self._own_version):
                self._send(sender, d.Alive(self._epoch, self._own_version, message.sent, taken))
            else:
                table = d.Table(self._epoch, self._own_version, self._own_nodes(), message.sent, taken)
                self._send(sender, table)
        elif isinstance(message, d.AskCounts):
            self._send(sender, self._counts(message.topic))
        else:
            self._send(sender, self._info())

    def _may_speak_for(self, member: _Member, peer: _Peer) -> bool:
        """Only who has registered a node changes it, or takes its leave."""
        if peer.owner == member.owner:
            return True
        self._refuse(f"{peer.owner} wants to speak for {member.record.name}, which is {member.owner}'s: refused")
        return False

    def _refuse(self, text: str) -> None:
        """Count what a member may not say; the log tells it once."""
        self._refused += 1
        self._refusal = text
        if text not in self._warned and len(self._warned) < _WARNINGS:
            self._warned.add(text)
            _log.warning("%s", text)

    def _changed(self, node: d.NodeRecord) -> None:
        """One of our own nodes is new or another: everybody is told."""
        self._version += 1
        self._own_version += 1
        self._to_members(d.Update(self._epoch, self._version, node))
        self._to_followers(d.Update(self._epoch, self._own_version, node))

    def _drop(self, incarnation: int, reason: d.Reason) -> None:
        if self._members.pop(incarnation, None) is not None:
            self._version += 1
            self._own_version += 1
            self._to_members(d.Gone(self._epoch, self._version, incarnation, reason))
            self._to_followers(d.Gone(self._epoch, self._own_version, incarnation, reason))

    def _pass_on(self, changes: Iterable[d.NodeRecord | tuple[int, d.Reason]]) -> None:
        """What has changed on another computer goes to our own nodes."""
        for change in changes:
            self._version += 1
            if isinstance(change, d.NodeRecord):
                self._to_members(d.Update(self._epoch, self._version, change))
            else:
                self._to_members(d.Gone(self._epoch, self._version, *change))

    def _tell_clocks(self) -> None:
        """How far the other computers' clocks are ahead, if it is known better, or another."""
        now = time.monotonic_ns()
        best = {link.computer.name: link.clock.best(now) for link in self._links}
        ahead = {name: sample.ahead for name, sample in best.items() if sample is not None}
        if any(abs(self._clocks_told.get(name, _UNKNOWN) - each) > _NOTABLE for name, each in ahead.items()):
            self._clocks_told = ahead
            self._to_members(d.Clocks(ahead))

    def _drop_silent(self) -> None:
        now = time.monotonic()
        if now - self._last_check > d.HEARTBEAT_PERIOD:
            # We were held up ourselves: everybody gets another chance to be heard.
            for member in self._members.values():
                member.heard += now - self._last_check
            for follower in self._followers.values():
                follower.heard += now - self._last_check
            for link in self._links:
                link.heard += now - self._last_check
        self._last_check = now
        silent = [i for i, member in self._members.items() if now - member.heard > d.NODE_TIMEOUT]
        for incarnation in silent:
            record = self._members[incarnation].record
            _log.warning("node %s (pid %d) is silent: dropped", record.name, record.pid)
            self._drop(incarnation, "silent")
        for computer in [c for c, follower in self._followers.items() if now - follower.heard > d.NODE_TIMEOUT]:
            del self._followers[computer]

    def _info(self) -> d.DaemonInfo:
        return d.DaemonInfo(
            pid=os.getpid(),
            cpu_percent=self._process.cpu_percent(),
            memory_mib=self._process.memory_info().rss / 2**20,
            uptime=time.monotonic() - self._started,
            nodes=len(self._members),
            computers=[link.computer.name for link in self._links if link.reachable],
            refused=self._refused,
            refusal=self._refusal,
            clocks=self._clocks(),
        )

    def _clocks(self) -> dict[str, tuple[float, float, float | None]]:
        now = time.monotonic_ns()
        best = {link.computer.name: (link.clock.best(now), link.clock.drift()) for link in self._links}
        return {n: (1e-9 * each.ahead, 1e-9 * each.error, drift) for n, (each, drift) in best.items() if each}

    def _counts(self, topic: str) -> d.Counts:
        found = {i: [c for c in member.counts if c.topic == topic] for i, member in self._members.items()}
        return d.Counts({incarnation: counts for incarnation, counts in found.items() if counts})

    def _own_nodes(self) -> list[d.NodeRecord]:
        return [member.record for member in self._members.values()]

    def _table(self) -> d.Table:
        others = (record for link in self._links if link.reachable for record in link.nodes.values())
        return d.Table(self._epoch, self._version, [*self._own_nodes(), *others])

    def _to_members(self, message: d.FromDaemon) -> None:
        content = d.encode(message)
        for member in self._members.values():
            self._send_bytes(member.routing_id, content)

    def _to_followers(self, message: d.FromDaemon) -> None:
        if self._followers:
            content = d.encode(message)
            for follower in self._followers.values():
                self._send_bytes(follower.routing_id, content)

    def _send(self, to: bytes, message: d.FromDaemon) -> None:
        self._send_bytes(to, d.encode(message))

    def _send_bytes(self, to: bytes, content: bytes) -> None:
        try:
            self._socket.send_multipart([to, content], zmq.NOBLOCK)
        except zmq.ZMQError:
            _log.debug("a node is not reachable")  # it asks for the table when it is back

    def close(self) -> None:
        """Give back the port."""
        self._keepsake.close()
        for link in self._links:
            link.socket.close()
        self._gate.close()
        self._socket.disable_monitor()
        self._monitor.close(0)
        self._socket.close()
        self._context.term()


def main() -> int:
    """Run the daemon of this computer until SIGTERM or SIGINT."""
    logging.basicConfig(
        level=logging.INFO,
        format="%(asctime)s %(levelname)s %(name)s: %(message)s",
        stream=sys.stderr,
    )
    stopping = False

    def stop(_signum: int, _frame: object) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    try:
        network = Network.from_environment(DAEMON)
        daemon = Daemon(network)
    except ConfigurationError as error:
        _log.error("%s", error)
        return EXIT_PORT_TAKEN if isinstance(error, PortTakenError) else EXIT_CONFIGURATION
    _log.info("listening on %s", network.computer.daemon)
    try:
        while not stopping:
            daemon.run_once(0.5)
    finally:
        daemon.close()
    _log.info("stopped")
    return 0


if __name__ == "__main__":
    sys.exit(main())
