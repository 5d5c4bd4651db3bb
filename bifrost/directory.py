"""What nodes and daemons tell each other: who is there and what each publishes, subscribes to, serves and calls."""

from __future__ import annotations

from typing import Literal

import msgspec

from bifrost.schema import Schema

Kind = Literal["publisher", "subscriber", "server", "client"]
# Why a node is gone: it took its leave, its connection to the daemon ended, or nothing was heard of it.
Reason = Literal["left", "lost", "silent"]

HEARTBEAT_PERIOD = 1.0  # of a node [s]
NODE_TIMEOUT = 3.5  # a node not heard of for this long is dropped [s]


class Entry(msgspec.Struct, frozen=True):
    """One publisher, subscriber, server or client of a node.

    Attributes:
        kind: which of the four.
        topic: its name.
        types: the names of the message types: of a topic one, of a service request and reply; empty: any.
        hashes: of their schemas, hexadecimal.
        endpoint: where it listens; empty for those that connect.
    """

    kind: Kind
    topic: str
    types: tuple[str, ...]
    hashes: tuple[str, ...]
    endpoint: str = ""


class NodeRecord(msgspec.Struct, frozen=True):
    """A node as the daemon knows it.

    Attributes:
        name: as it calls itself; two nodes may share one.
        incarnation: a random number that no other node, and no later run of this one, has.
        pid: of its process.
        computer: where it runs.
        started: wall clock [ns].
        entries: all that it has.
        schemas: by hash, of every type in ``entries``.
    """

    name: str
    incarnation: int
    pid: int
    computer: str
    started: int
    entries: tuple[Entry, ...] = ()
    schemas: dict[str, Schema] = {}


# From node to daemon.


class Register(msgspec.Struct, tag="register"):
    """This is all that I have now."""

    node: NodeRecord


class Heartbeat(msgspec.Struct, tag="heartbeat"):
    """I am alive; ``version`` is that of the table I hold."""

    incarnation: int
    epoch: int
    version: int


class Leave(msgspec.Struct, tag="leave"):
    """I close."""

    incarnation: int


class Ask(msgspec.Struct, tag="ask"):
    """How are you?"""


# From daemon to node.


class Table(msgspec.Struct, tag="table"):
    """Every node that the daemon knows. ``epoch`` is the daemon's incarnation."""

    epoch: int
    version: int
    nodes: list[NodeRecord]


class Update(msgspec.Struct, tag="update"):
    """A node is new or has changed."""

    epoch: int
    version: int
    node: NodeRecord


class Gone(msgspec.Struct, tag="gone"):
    """A node is no longer in the table."""

    epoch: int
    version: int
    incarnation: int
    reason: Reason


class Alive(msgspec.Struct, tag="alive"):
    """Answer to a heartbeat."""

    epoch: int
    version: int


class Unknown(msgspec.Struct, tag="unknown"):
    """Answer to the heartbeat of a node that is not in the table: register."""

    epoch: int


class DaemonInfo(msgspec.Struct, tag="info"):
    """How a daemon fares."""

    pid: int
    cpu_percent: float  # of one core, over the last seconds
    memory_mib: float
    uptime: float  # [s]
    nodes: int


FromNode = Register | Heartbeat | Leave | Ask
FromDaemon = Table | Update | Gone | Alive | Unknown | DaemonInfo

encode = msgspec.msgpack.Encoder().encode
decode_from_node = msgspec.msgpack.Decoder(FromNode).decode
decode_from_daemon = msgspec.msgpack.Decoder(FromDaemon).decode
