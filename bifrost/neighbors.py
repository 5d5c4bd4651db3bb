"""Who is there, by topic: what one node knows of the network.

The discovery thread fills it; whoever connects holds a ``Watch`` of one topic's publishers or servers.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from bifrost import directory as d
from bifrost.schema import Schema

# How long subscribers stay connected to the publishers of a node that is no longer in the table [s]: what it sent last
# may be on its way; a starved machine makes the living silent; a new daemon does not know everybody at once; and while
# a daemon is away its nodes go on.
_KEPT: dict[d.Reason, float] = {"left": 1.0, "lost": 3.0, "silent": 10.0, "forgotten": 10.0, "unreachable": 600.0}
_MAYBE_ALIVE: frozenset[d.Reason] = frozenset(("silent", "forgotten", "unreachable"))

_Key = tuple[d.Kind, str]


@dataclass(frozen=True)
class Peer:
    """An entry of a node, and whose it is."""

    node: str
    incarnation: int
    computer: str
    started: int
    entry: d.Entry
    alive: bool  # as far as is known; False: gone, and what it sent last may still be on its way


@dataclass
class Watch:
    """The peers of one topic; the last is the one to call. ``peers`` is replaced as a whole."""

    kind: d.Kind
    topic: str
    notify: Callable[[], None]
    peers: tuple[Peer, ...] = ()


@dataclass
class _Departed:
    record: d.NodeRecord
    until: float
    alive: bool  # it may be


class Neighbors:
    """Every node known, indexed by topic. Not locked: that is the owner's part.

    Attributes:
        nodes: the others' records, as the daemon has them now.
        epoch: of the daemon that they come from.
        version: of its table; −1 before the first.
    """

    def __init__(self, here: str) -> None:
        """Of a node on the computer ``here``."""
        self._here = here
        self.nodes: dict[int, d.NodeRecord] = {}
        self.epoch = 0
        self.version = -1
        self._departed: dict[int, _Departed] = {}
        self._own_record: d.NodeRecord | None = None
        self._own: dict[_Key, list[d.Entry]] = {}
        self._ends: dict[_Key, dict[int, list[d.Entry]]] = {}  # by incarnation of the others, departed ones included
        self._watches: dict[_Key, list[Watch]] = {}
        self._changed: set[_Key] = set()

    # --- filling --------------------------------------------------------------------------------------------------

    def replace(self, records: Iterable[d.NodeRecord], epoch: int, version: int) -> None:
        """Take a whole table."""
        new = {record.incarnation: record for record in records}
        reason: d.Reason = "lost" if epoch == self.epoch else "forgotten"
        for incarnation in [i for i in self.nodes if i not in new]:
            self.depart(incarnation, reason)
        for record in new.values():
            self.put(record)
        self.epoch, self.version = epoch, version

    def put(self, record: d.NodeRecord) -> None:
        """A node is new or has changed."""
        incarnation = record.incarnation
        departed = self._departed.pop(incarnation, None)
        old = departed.record if departed else self.nodes.get(incarnation)
        self.nodes[incarnation] = record
        before = _by_key(old.entries) if old else {}
        now = _by_key(record.entries)
        self._unindex(incarnation, before.keys() - now.keys())
        for key, entries in now.items():
            self._ends.setdefault(key, {})[incarnation] = entries
        # Of a node with a thousand topics, one of which is new, no other is looked at again.
        every = before.keys() | now.keys()
        self._changed |= every if departed else {key for key in every if before.get(key) != now.get(key)}

    def depart(self, incarnation: int, reason: d.Reason) -> None:
        """A node is no longer in the table. Whoever is connected to it may stay so for a while."""
        record = self.nodes.pop(incarnation, None)
        if record is None and incarnation in self._departed:
            record = self._departed[incarnation].record
        if record is not None:
            self._departed[incarnation] = _Departed(record, time.monotonic() + _KEPT[reason], reason in _MAYBE_ALIVE)
            self._changed |= _by_key(record.entries).keys()

    def forget_departed(self) -> None:
        """Let go of those whose time is over."""
        now = time.monotonic()
        for incarnation in [i for i, departed in self._departed.items() if now > departed.until]:
            record = self._departed.pop(incarnation).record
            keys = _by_key(record.entries).keys()
            self._unindex(incarnation, keys)
            self._changed |= keys

    def add_own(self, record: d.NodeRecord, entry: d.Entry) -> None:
        """This node has one entry more. ``record`` tells of the node alone: its entries are not looked at."""
        self._own_record = record
        self._own.setdefault((entry.kind, entry.topic), []).append(entry)
        self._changed.add((entry.kind, entry.topic))

    def remove_own(self, entry: d.Entry) -> None:
        """This node has one entry less."""
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

    # --- looking --------------------------------------------------------------------------------------------------

    @property
    def any_departed(self) -> bool:
        """Whether there is anybody to forget some time."""
        return bool(self._departed)

    def schema(self, digest: str) -> Schema | None:
        """The schema of a hash (hexadecimal), if any other node has registered it, and truly."""
        departed = (each.record for each in self._departed.values())
        for record in (*self.nodes.values(), *departed):
            schema = record.schemas.get(digest)
            if schema is not None and schema.digest().hex() == digest:
                return schema
        return None

    def watch(self, watch: Watch) -> None:
        """Keep a watch's peers up to date, and tell it of changes."""
        watch.peers = self._peers(watch.kind, watch.topic)
        self._watches.setdefault((watch.kind, watch.topic), []).append(watch)

    def unwatch(self, watch: Watch) -> None:
        """Let a watch go."""
        watches = self._watches[watch.kind, watch.topic]
        watches.remove(watch)
        if not watches:
            del self._watches[watch.kind, watch.topic]

    def refresh(self) -> None:
        """Tell the watches whose topics have changed."""
        changed, self._changed = self._changed, set()
        for key in changed:
            for watch in self._watches.get(key, ()):
                peers = self._peers(*key)
                if peers != watch.peers:
                    watch.peers = peers
                    watch.notify()

    def _peers(self, kind: d.Kind, topic: str) -> tuple[Peer, ...]:
        """Those in the table last; of these those of this computer; of each computer's the node started last.

        Of the departed, those that matter.
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
