"""Messages between nodes and daemons: nodes, and what each publishes, subscribes to, serves and calls.

A daemon owns the records of its computer's nodes. It follows the daemons of the other computers, which send the records
of theirs, and forwards changes to its nodes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import msgspec
import zmq

from bifrost.grants import MEMBER, Grants
from bifrost.messages import Schema

Kind = Literal["publisher", "subscriber", "server", "client"]
# Reason why a node left the table: it closed; its connection to the daemon ended; it timed out; its computer's daemon
# is new and does not have it yet; or that daemon is unreachable.
Reason = Literal["left", "lost", "silent", "forgotten", "unreachable"]

HEARTBEAT_PERIOD = 1.0  # of a node, and of a daemon that follows another [s]
NODE_TIMEOUT = 3.5  # time without messages after which a node or daemon is dropped [s]


class Entry(msgspec.Struct, frozen=True):
    """One publisher, subscriber, server or client of a node."""

    kind: Kind
    topic: str
    types: tuple[str, ...]  # names: one of a topic, request and reply of a service; empty: any
    hashes: tuple[str, ...]  # of their schemas, hexadecimal
    endpoint: str = ""  # that it listens on; empty for ends that connect
    latched: bool = False  # late subscribers get the publisher's last message
    key: str = ""  # public key that it listens with, Z85; empty: the network's


class NodeRecord(msgspec.Struct, frozen=True):
    """A node in the table."""

    name: str  # not unique
    incarnation: int  # a random number that no other node, and no later run of this one, has
    pid: int
    computer: str  # on which it runs
    started: int  # by the monotonic clock of its computer [ns]; not comparable between computers
    entries: tuple[Entry, ...] = ()
    schemas: dict[str, Schema] = {}  # by hash, of every type in entries

    def sifted(self, grants: Grants, proven: str | None = None) -> tuple[NodeRecord, list[str]]:
        """The record without entries that its node may not have, and the reasons.

        ``proven``: owner that its connection has proven; None: unknown, and the announced keys count. Nodes detect
        false keys when they connect.
        """
        if not grants.owners:
            return self, []
        kept: list[Entry] = []
        refusals = []
        for entry in self.entries:
            owner = grants.owner_of(entry.key)
            shown = owner if proven is None or proven == owner else MEMBER
            if refusal := grants.refusal(self.name, entry.kind, entry.topic, shown):
                refusals.append(f"{refusal}: rejected")
            else:
                kept.append(entry)
        return (msgspec.structs.replace(self, entries=tuple(kept)) if refusals else self), refusals


# From node to daemon.


class Register(msgspec.Struct, tag="register"):
    """Complete record of a node."""

    node: NodeRecord


class Heartbeat(msgspec.Struct, tag="heartbeat"):
    """Periodic message; ``version``: of the node's table."""

    incarnation: int
    epoch: int
    version: int


class Leave(msgspec.Struct, tag="leave"):
    """Close of a node."""

    incarnation: int


class Ask(msgspec.Struct, tag="ask"):
    """Request for ``DaemonInfo``."""


# From daemon to daemon.


class Follow(msgspec.Struct, tag="follow"):
    """Periodic request for the records of a daemon's own nodes; ``version``: of the follower's copy.

    ``sent``: time by the follower's monotonic clock [ns].
    """

    computer: str
    epoch: int
    version: int
    sent: int = 0


# From daemon to node, and to the daemons that follow it.


class Table(msgspec.Struct, tag="table"):
    """All nodes of the daemon's table; for a follower, its own nodes. ``epoch`` is the daemon's incarnation.

    For a follower also ``sent`` of its request, and ``taken``: time of receipt by the daemon's clock [ns].
    """

    epoch: int
    version: int
    nodes: list[NodeRecord]
    sent: int = 0
    taken: int = 0


class Update(msgspec.Struct, tag="update"):
    """A new or changed node."""

    epoch: int
    version: int
    node: NodeRecord


class Gone(msgspec.Struct, tag="gone"):
    """A node that has left the table."""

    epoch: int
    version: int
    incarnation: int
    reason: Reason


class Alive(msgspec.Struct, tag="alive"):
    """Reply to a heartbeat; to a follower with ``sent`` and ``taken`` as in a table."""

    epoch: int
    version: int
    sent: int = 0
    taken: int = 0


class Clocks(msgspec.Struct, tag="clocks"):
    """Offsets of other computers' monotonic clocks to this one's [ns]."""

    ahead: dict[str, int]


class Unknown(msgspec.Struct, tag="unknown"):
    """Reply to the heartbeat of a node that is not in the table; the node registers."""

    epoch: int


class DaemonInfo(msgspec.Struct, tag="info"):
    """Status of a daemon."""

    pid: int
    cpu_percent: float  # of one core, over the last seconds
    memory_mib: float
    uptime: float  # [s]
    nodes: int  # of its own computer
    computers: list[str] = []  # reachable other computers
    refused: int = 0  # invalid or unauthorised messages of members
    refusal: str = ""  # latest unauthorised message
    clocks: dict[str, tuple[float, float]] = {}  # of other computers: offset of the monotonic clock, and its error [s]


ToDaemon = Register | Heartbeat | Leave | Ask | Follow
FromDaemon = Table | Update | Gone | Alive | Unknown | DaemonInfo | Clocks

encode = msgspec.msgpack.Encoder().encode
decode_to_daemon = msgspec.msgpack.Decoder(ToDaemon).decode
_decode_from_daemon = msgspec.msgpack.Decoder(FromDaemon).decode


def from_daemon(socket: zmq.Socket[bytes]) -> Iterator[FromDaemon]:
    """Messages that wait on a socket connected to a daemon, without those of another version."""
    while True:
        try:
            content = socket.recv(zmq.NOBLOCK)
        except zmq.Again:
            return
        try:
            message = _decode_from_daemon(content)
        except (ValueError, RecursionError):
            continue
        yield message
