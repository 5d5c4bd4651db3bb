"""What nodes and daemons tell each other: who is there and what each publishes, subscribes to, serves and calls.

A daemon owns the records of its own computer's nodes. It follows the daemons of the others, each of which tells it of
its own nodes, and passes on to its nodes what it learns.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from bifrost.grants import MEMBER, Grants
from bifrost.schema import Schema

Kind = Literal["publisher", "subscriber", "server", "client"]
# Why a node is gone: it took its leave, its connection to the daemon ended, or nothing was heard of it; its computer's
# daemon is new and does not know it yet, or cannot be reached from here.
Reason = Literal["left", "lost", "silent", "forgotten", "unreachable"]

HEARTBEAT_PERIOD = 1.0  # of a node, and of a daemon that follows another [s]
NODE_TIMEOUT = 3.5  # a node, or a daemon, not heard of for this long is dropped [s]


class Entry(msgspec.Struct, frozen=True):
    """One publisher, subscriber, server or client of a node.

    Attributes:
        kind: which of the four.
        topic: its name.
        types: the names of the message types: of a topic one, of a service request and reply; empty: any.
        hashes: of their schemas, hexadecimal.
        endpoint: where it listens; empty for those that connect.
        latched: of a publisher: whoever comes late gets its last message.
        key: public, Z85, that it listens with; empty: that of the network.
    """

    kind: Kind
    topic: str
    types: tuple[str, ...]
    hashes: tuple[str, ...]
    endpoint: str = ""
    latched: bool = False
    key: str = ""


class NodeRecord(msgspec.Struct, frozen=True):
    """A node as the daemon knows it.

    Attributes:
        name: as it calls itself; two nodes may share one.
        incarnation: a random number that no other node, and no later run of this one, has.
        pid: of its process.
        computer: where it runs.
        started: monotonic clock of its computer [ns]; with that of another computer it cannot be compared.
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

    def sifted(self, grants: Grants, proven: str | None = None) -> tuple[NodeRecord, list[str]]:
        """The record without what its node may not have, and why that is refused.

        Args:
            grants: of the network.
            proven: the owner that its connection has proven it to be; None: nothing is known of that, and the keys that
                it announces count. A false one is found out by whoever connects.
        """
        if not grants.owners:
            return self, []
        kept: list[Entry] = []
        refusals = []
        for entry in self.entries:
            owner = grants.owner_of(entry.key)
            shown = owner if proven is None or proven == owner else MEMBER
            if refusal := grants.refusal(self.name, entry.kind, entry.topic, shown):
                refusals.append(f"{refusal}: refused")
            else:
                kept.append(entry)
        return (msgspec.structs.replace(self, entries=tuple(kept)) if refusals else self), refusals


class Count(msgspec.Struct, frozen=True, array_like=True):
    """What has passed one end of a topic since it was made.

    Attributes:
        kind: which end.
        topic: its name.
        messages: published or received.
        drops: known lost.
        rejected: refused.
    """

    kind: Kind
    topic: str
    messages: int
    drops: int = 0
    rejected: int = 0


# From node to daemon.


class Register(msgspec.Struct, tag="register"):
    """This is all that I have now."""

    node: NodeRecord


class Heartbeat(msgspec.Struct, tag="heartbeat"):
    """I am alive; ``version`` is that of the table I hold; ``counts``, if any has changed, are all of mine."""

    incarnation: int
    epoch: int
    version: int
    counts: list[Count] | None = None


class Leave(msgspec.Struct, tag="leave"):
    """I close."""

    incarnation: int


class Ask(msgspec.Struct, tag="ask"):
    """How are you?"""


class AskCounts(msgspec.Struct, tag="ask_counts"):
    """What has passed the ends of a topic at your nodes?"""

    topic: str


# From daemon to daemon.


class Follow(msgspec.Struct, tag="follow"):
    """Tell me of your own nodes; ``version`` is that of what I know of them. Sent as a heartbeat.

    ``sent`` is when, by the asking computer's monotonic clock [ns].
    """

    computer: str
    epoch: int
    version: int
    sent: int = 0


# From daemon to node, and to the daemons that follow it.


class Table(msgspec.Struct, tag="table"):
    """Every node that the daemon knows; to a follower, its own. ``epoch`` is the daemon's incarnation.

    To a follower, too, ``sent`` of what it asked, and when that was ``taken``, by the answering computer's clock [ns].
    """

    epoch: int
    version: int
    nodes: list[NodeRecord]
    sent: int = 0
    taken: int = 0


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
    """Answer to a heartbeat; to a follower's with ``sent`` and ``taken`` as in a table."""

    epoch: int
    version: int
    sent: int = 0
    taken: int = 0


class Clocks(msgspec.Struct, tag="clocks"):
    """By how much the monotonic clocks of other computers are ahead of this one's [ns]."""

    ahead: dict[str, int]


class Unknown(msgspec.Struct, tag="unknown"):
    """Answer to the heartbeat of a node that is not in the table: register."""

    epoch: int


class DaemonInfo(msgspec.Struct, tag="info"):
    """How a daemon fares."""

    pid: int
    cpu_percent: float  # of one core, over the last seconds
    memory_mib: float
    uptime: float  # [s]
    nodes: int  # of its own computer
    computers: list[str] = []  # the others that it reaches
    refused: int = 0  # what members have sent that is no message, or not theirs to say
    refusal: str = ""  # the newest of what was not theirs
    # Of other computers by name: how far their monotonic clock is ahead, to which error [s], and how it drifts [s/s].
    clocks: dict[str, tuple[float, float, float | None]] = {}


class Counts(msgspec.Struct, tag="counts"):
    """Answer to ``AskCounts``: by incarnation of the node, in the order of its record's entries."""

    counts: dict[int, list[Count]]


ToDaemon = Register | Heartbeat | Leave | Ask | AskCounts | Follow
FromDaemon = Table | Update | Gone | Alive | Unknown | DaemonInfo | Counts | Clocks

encode = msgspec.msgpack.Encoder().encode
decode_to_daemon = msgspec.msgpack.Decoder(ToDaemon).decode
decode_from_daemon = msgspec.msgpack.Decoder(FromDaemon).decode
