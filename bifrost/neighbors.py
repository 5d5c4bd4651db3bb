"""A node's copy of the table: all nodes, indexed by topic.

The discovery thread updates it; subscribers and clients hold a ``Watch`` of one topic's publishers or servers.
"""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from bifrost import directory as d
from bifrost.messages import Schema

# Time that subscribers remain connected to publishers of a node that has left the table [s]: its last messages may be
# under way; on a busy machine, nodes time out although they run; a new daemon does not have all nodes at once; and
# nodes run on while their daemon is down.
_KEPT: dict[d.Reason, float] = {"left": 1.0, "lost": 3.0, "silent": 10.0, "forgotten": 10.0, "unreachable": 600.0}
_MAYBE_ALIVE: frozenset[d.Reason] = frozenset(("silent", "forgotten", "unreachable"))

_Key = tuple[d.Kind, str]


@dataclass(frozen=True)
class Peer:
    """An entry with its node."""

    node: str
    incarnation: int
    computer: str
    started: int
    entry: d.Entry
    alive: bool  # False: the node has ended; its last messages may be under way


@dataclass
class Watch:
    """The peers of one topic; clients call the last. ``peers`` is replaced as a whole."""

    kind: d.Kind
    topic: str
    notify: Callable[[], None]
    peers: tuple[Peer, ...] = ()


@dataclass
class _Departed:
    record: d.NodeRecord
    until: float
    alive: bool  # possibly


class Neighbors:
    """All nodes, indexed by topic. Without a lock: the owner locks."""

    def __init__(self, here: str) -> None:
        """Start empty, for a node on the computer ``here``."""
        self._here = here
        self.nodes: dict[int, d.NodeRecord] = {}  # records of the other nodes, as in the daemon's table
        self.epoch = 0  # of the daemon
        self.version = -1  # of its table; −1 before the first
        self._departed: dict[int, _Departed] = {}
        self._own_record: d.NodeRecord | None = None
        self._own: dict[_Key, list[d.Entry]] = {}
        self._ends: dict[_Key, dict[int, list[d.Entry]]] = {}  # by incarnation of the others, departed ones included
        self._watches: dict[_Key, list[Watch]] = {}
        self._changed: set[_Key] = set()

    def replace(self, records: Iterable[d.NodeRecord], epoch: int, version: int) -> None:
        """Replace the table."""
        new = {record.incarnation: record for record in records}
        reason: d.Reason = "lost" if epoch == self.epoch else "forgotten"
        for incarnation in [i for i in self.nodes if i not in new]:
            self.depart(incarnation, reason)
        for record in new.values():
            self.put(record)
        self.epoch, self.version = epoch, version

    def put(self, record: d.NodeRecord) -> None:
        """Add or replace a node."""
        incarnation = record.incarnation
        departed = self._departed.pop(incarnation, None)
        old = departed.record if departed else self.nodes.get(incarnation)
        self.nodes[incarnation] = record
        before = _by_key(old.entries) if old else {}
        now = _by_key(record.entries)
        self._unindex(incarnation, before.keys() - now.keys())
        for key, entries in now.items():
            self._ends.setdefault(key, {})[incarnation] = entries
        # Of a node with a thousand topics, only changed ones are processed again.
        every = before.keys() | now.keys()
        self._changed |= every if departed else {key for key in every if before.get(key) != now.get(key)}

    def depart(self, incarnation: int, reason: d.Reason) -> None:
        """Remove a node from the table. Connections to it persist for a while."""
        record = self.nodes.pop(incarnation, None)
        if record is None and incarnation in self._departed:
            record = self._departed[incarnation].record
        if record is not None:
            self._departed[incarnation] = _Departed(record, time.monotonic() + _KEPT[reason], reason in _MAYBE_ALIVE)
            self._changed |= _by_key(record.entries).keys()

    def forget_departed(self) -> None:
        """Discard departed nodes after their time."""
        now = time.monotonic()
        for incarnation in [i for i, departed in self._departed.items() if now > departed.until]:
            record = self._departed.pop(incarnation).record
            keys = _by_key(record.entries).keys()
            self._unindex(incarnation, keys)
            self._changed |= keys

    def add_own(self, record: d.NodeRecord, entry: d.Entry) -> None:
        """Add an entry of this node; ``record`` describes the node, its entries are not used."""
        self._own_record = record
        self._own.setdefault((entry.kind, entry.topic), []).append(entry)
        self._changed.add((entry.kind, entry.topic))

    def remove_own(self, entry: d.Entry) -> None:
        """Remove an entry of this node."""
        key = (entry.kind, entry.topic)
        self._own[key].remove(entry)
        if not self._own[key]:
            del self._own[key]
        self._changed.add(key)

    def _unindex(self, incarnation: int, keys: Iterable[_Key]) -> None:
        for key in keys:
            ends = self._ends.get(key)
            if ends is not None:
                ends.pop(incarnation, None)
                if not ends:
                    del self._ends[key]

    @property
    def any_departed(self) -> bool:
        """True if departed nodes are stored."""
        return bool(self._departed)

    def schema(self, digest: str) -> Schema | None:
        """The schema of a hash (hexadecimal), if another node has registered it and the hash is right."""
        departed = (each.record for each in self._departed.values())
        for record in (*self.nodes.values(), *departed):
            schema = record.schemas.get(digest)
            if schema is not None and schema.digest().hex() == digest:
                return schema
        return None

    def watch(self, watch: Watch) -> None:
        """Update a watch's peers, and notify it of changes."""
        watch.peers = self._peers(watch.kind, watch.topic)
        self._watches.setdefault((watch.kind, watch.topic), []).append(watch)

    def unwatch(self, watch: Watch) -> None:
        """Remove a watch."""
        watches = self._watches[watch.kind, watch.topic]
        watches.remove(watch)
        if not watches:
            del self._watches[watch.kind, watch.topic]

    def refresh(self) -> None:
        """Notify the watches of changed topics."""
        changed, self._changed = self._changed, set()
        for key in changed:
            for watch in self._watches.get(key, ()):
                peers = self._peers(*key)
                if peers != watch.peers:
                    watch.peers = peers
                    watch.notify()

    def _peers(self, kind: d.Kind, topic: str) -> tuple[Peer, ...]:
        """Peers in order: departed nodes, then other computers, then this one; on each, by start of the node.

        Departed nodes are included if they are publishers, or possibly alive.
        """
        found: list[tuple[bool, Peer]] = []
        for incarnation, entries in self._ends.get((kind, topic), {}).items():
            departed = self._departed.get(incarnation)
            record = departed.record if departed else self.nodes[incarnation]
            alive = departed is None or departed.alive
            if alive or kind == "publisher":
                found += [(departed is None, _peer(record, entry, alive)) for entry in entries]
        if self._own_record is not None:
            found += [(True, _peer(self._own_record, entry, True)) for entry in self._own.get((kind, topic), ())]
        found.sort(key=lambda pair: (pair[0], pair[1].computer == self._here, pair[1].computer, pair[1].started))
        return tuple(peer for _, peer in found)


def _peer(record: d.NodeRecord, entry: d.Entry, alive: bool) -> Peer:
    return Peer(record.name, record.incarnation, record.computer, record.started, entry, alive)


def _by_key(entries: Iterable[d.Entry]) -> dict[_Key, list[d.Entry]]:
    found: dict[_Key, list[d.Entry]] = {}
    for entry in entries:
        found.setdefault((entry.kind, entry.topic), []).append(entry)
    return found
