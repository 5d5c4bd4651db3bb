"""``python -m bifrost.daemon``: the name service of one computer.

It stores the table of its computer's nodes, follows the daemons of the other computers, and sends every change to all
of its nodes at once. Messages do not pass through it.
"""

import contextlib
import errno
import logging
import os
import secrets
import signal
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import psutil
import zmq
from zmq.utils.monitor import recv_monitor_message

from bifrost import directory as d
from bifrost.clocks import Sample
from bifrost.errors import ConfigurationError
from bifrost.grants import DAEMON
from bifrost.network import Network
from bifrost.remote_daemon import RemoteDaemon
from bifrost.security import Gate, listening_socket, new_context
from bifrost.table_cache import TableCache

_log = logging.getLogger("bifrostd")
_NOTABLE = 20_000  # change of a clock's offset that is sent to nodes [ns]
_UNKNOWN = 2**63  # above any offset [ns]
_WARNINGS = 100  # maximum number of logged rejections
EXIT_CONFIGURATION = 78  # sysexits' EX_CONFIG
EXIT_PORT_TAKEN = 75  # EX_TEMPFAIL: the port may become free, so that a restart can succeed


class PortTakenError(ConfigurationError):
    """Another process listens on the daemon's port."""


@dataclass(frozen=True)
class _Peer:
    """Sender of a message."""

    routing_id: bytes
    descriptor: int  # of its connection
    owner: str  # proven by its connection; or a member


@dataclass
class _Member:
    peer: _Peer
    record: d.NodeRecord
    heard: float


@dataclass
class _Follower:
    routing_id: bytes
    heard: float


class Daemon:
    """The table, the socket to the nodes, and the sockets to the other computers' daemons.

    It counts two versions: of the complete table, for its nodes, and of its own nodes, for followers.
    """

    def __init__(self, network: Network) -> None:
        self._context = new_context()
        self._grants = network.grants
        if network.owner != self._grants.daemon:
            raise ConfigurationError(f"the key of {DAEMON} is missing: expected its folder in BIFROST_OWNERS")
        self._remotes: list[RemoteDaemon] = []
        self._table_cache = TableCache(network.table_cache)
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
        self._remotes = [RemoteDaemon(self._context, network, other) for other in network.others]
        self._poller = zmq.Poller()
        for socket in (self._gate.socket, self._monitor, self._socket, *(remote.socket for remote in self._remotes)):
            self._poller.register(socket, zmq.POLLIN)
        self._epoch = secrets.randbits(63)
        self._version = 0
        self._own_version = 0
        self._clocks_sent: dict[str, int] = {}
        self._refused = 0
        self._refusal = ""
        self._warned: set[str] = set()
        self._process = psutil.Process()
        self._process.cpu_percent()
        self._started = time.monotonic()
        self._last_check = self._started

    def run_once(self, timeout: float) -> None:
        """Process messages that arrive within ``timeout`` [s]."""
        ready = dict(self._poller.poll(max(0, int(timeout * 1000))))
        if self._gate.socket in ready:
            self._gate.answer()
        lost = self._disconnected() if self._monitor in ready else []
        if self._socket in ready:
            self._receive()  # before the lost nodes are dropped: most have sent Leave
        for incarnation in lost:
            if incarnation in self._members:
                record = self._members[incarnation].record
                _log.info("node %s (pid %d) disconnected without leaving", record.name, record.pid)
                self._drop(incarnation, "lost")
        for remote in self._remotes:
            if remote.socket in ready:
                changes = remote.receive()
                self._send_clocks()  # before its nodes, whose stamps it converts
                self._pass_on(changes)
            self._pass_on(remote.check())
        self._drop_silent()
        self._table_cache.update(self._version, self._table)

    def _disconnected(self) -> list[int]:
        """The nodes whose connection has ended. A running node registers again after its next heartbeat."""
        ended = set()
        while self._monitor.poll(0):
            ended.add(recv_monitor_message(self._monitor)["value"])
        return [i for i, member in self._members.items() if member.peer.descriptor in ended]

    def _receive(self) -> None:
        for _ in range(1000):
            try:
                frames = self._socket.recv_multipart(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                return
            try:
                sender, content = frames
                message = d.decode_to_daemon(content.buffer)
            except (ValueError, RecursionError):
                self._refused += 1  # from a member of another version, which then times out
                continue
            self._handle(_Peer(sender.bytes, int(content.get(zmq.SRCFD)), str(content.get("User-Id"))), message)

    def _handle(self, peer: _Peer, message: d.ToDaemon) -> None:
        if isinstance(message, d.Heartbeat):
            self._heartbeat(peer, message)
        elif isinstance(message, d.Register):
            self._register(peer, message.node)
        elif isinstance(message, d.Leave):
            member = self._members.get(message.incarnation)
            if member is not None and self._may_change(member, peer):
                self._drop(message.incarnation, "left")
        elif isinstance(message, d.Follow):
            self._follow(peer, message)
        else:
            self._send(peer.routing_id, self._info())

    def _heartbeat(self, peer: _Peer, message: d.Heartbeat) -> None:
        member = self._members.get(message.incarnation)
        if member is None:
            self._send(peer.routing_id, d.Unknown(self._epoch))
        elif self._may_change(member, peer):
            member.heard, member.peer = time.monotonic(), peer
            current = (message.epoch, message.version) == (self._epoch, self._version)
            self._send(peer.routing_id, d.Alive(self._epoch, self._version) if current else self._table())

    def _register(self, peer: _Peer, node: d.NodeRecord) -> None:
        known = self._members.get(node.incarnation)
        if known is not None and not self._may_change(known, peer):
            return
        node, refusals = node.sifted(self._grants, peer.owner)
        for refusal in refusals:
            self._reject(f"{refusal} (pid {node.pid} on {node.computer}, key of {peer.owner})")
        self._members[node.incarnation] = _Member(peer, node, time.monotonic())
        if known is None or known.record != node:
            self._changed(node)
        if known is None:
            if self._clocks_sent:
                self._send(peer.routing_id, d.Clocks(self._clocks_sent))
            self._send(peer.routing_id, self._table())

    def _follow(self, peer: _Peer, message: d.Follow) -> None:
        taken = time.monotonic_ns()
        if peer.owner != self._grants.daemon:
            self._reject(f"{peer.owner} may not follow as the daemon of {message.computer}: rejected")
            return
        self._followers[message.computer] = _Follower(peer.routing_id, time.monotonic())
        if (message.epoch, message.version) == (self._epoch, self._own_version):
            self._send(peer.routing_id, d.Alive(self._epoch, self._own_version, message.sent, taken))
        else:
            table = d.Table(self._epoch, self._own_version, self._own_nodes(), message.sent, taken)
            self._send(peer.routing_id, table)

    def _may_change(self, member: _Member, peer: _Peer) -> bool:
        """Return whether the sender has the owner that registered the node; rejected otherwise."""
        owner = member.peer.owner
        if peer.owner != owner:
            self._reject(f"{peer.owner} may not change {member.record.name}, which belongs to {owner}: rejected")
        return peer.owner == owner

    def _reject(self, text: str) -> None:
        """Count an unauthorised message; log it once."""
        self._refused += 1
        self._refusal = text
        if text not in self._warned and len(self._warned) < _WARNINGS:
            self._warned.add(text)
            _log.warning("%s", text)

    def _changed(self, node: d.NodeRecord) -> None:
        """Send a new or changed node of this computer to all nodes and followers."""
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
        """Send changes on another computer to this computer's nodes."""
        for change in changes:
            self._version += 1
            if isinstance(change, d.NodeRecord):
                self._to_members(d.Update(self._epoch, self._version, change))
            else:
                self._to_members(d.Gone(self._epoch, self._version, *change))

    def _send_clocks(self) -> None:
        """Send the offsets of the other computers' clocks to all nodes, if they have changed."""
        ahead = {name: sample.ahead for name, sample in self._clocks().items()}
        if any(abs(self._clocks_sent.get(name, _UNKNOWN) - each) > _NOTABLE for name, each in ahead.items()):
            self._clocks_sent = ahead
            self._to_members(d.Clocks(ahead))

    def _drop_silent(self) -> None:
        now = time.monotonic()
        if now - self._last_check > d.HEARTBEAT_PERIOD:
            # This process was delayed: extend the timeout of all nodes.
            delayed: list[_Member | _Follower | RemoteDaemon]
            delayed = [*self._members.values(), *self._followers.values(), *self._remotes]
            for each in delayed:
                each.heard += now - self._last_check
        self._last_check = now
        silent = [i for i, member in self._members.items() if now - member.heard > d.NODE_TIMEOUT]
        for incarnation in silent:
            record = self._members[incarnation].record
            _log.warning("node %s (pid %d) has timed out: dropped", record.name, record.pid)
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
            computers=[remote.computer.name for remote in self._remotes if remote.reachable],
            refused=self._refused,
            refusal=self._refusal,
            clocks={name: (1e-9 * each.ahead, 1e-9 * each.error) for name, each in self._clocks().items()},
        )

    def _clocks(self) -> dict[str, Sample]:
        now = time.monotonic_ns()
        best = {remote.computer.name: remote.clock.best(now) for remote in self._remotes}
        return {name: sample for name, sample in best.items() if sample is not None}

    def _own_nodes(self) -> list[d.NodeRecord]:
        return [member.record for member in self._members.values()]

    def _table(self) -> d.Table:
        others = (record for remote in self._remotes if remote.reachable for record in remote.nodes.values())
        return d.Table(self._epoch, self._version, [*self._own_nodes(), *others])

    def _to_members(self, message: d.FromDaemon) -> None:
        self._send_all([member.peer.routing_id for member in self._members.values()], message)

    def _to_followers(self, message: d.FromDaemon) -> None:
        self._send_all([follower.routing_id for follower in self._followers.values()], message)

    def _send(self, to: bytes, message: d.FromDaemon) -> None:
        self._send_all([to], message)

    def _send_all(self, receivers: Sequence[bytes], message: d.FromDaemon) -> None:
        content = d.encode(message) if receivers else b""
        for receiver in receivers:
            with contextlib.suppress(zmq.ZMQError):  # an unreachable node requests the table when it reconnects
                self._socket.send_multipart([receiver, content], zmq.NOBLOCK)

    def close(self) -> None:
        """Close all sockets."""
        self._table_cache.close()
        for remote in self._remotes:
            remote.socket.close()
        self._gate.close()
        self._socket.disable_monitor()
        self._monitor.close(0)
        self._socket.close()
        self._context.term()


def main() -> int:
    """Run the daemon of this computer until SIGTERM or SIGINT; returns the exit status."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
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
