"""The index of nodes by topic, against a search of all records."""

from functools import partial

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from bifrost import directory as d
from bifrost.neighbors import Neighbors, Peer, Watch
from harness.examples import examples

_ENTRIES = st.lists(
    st.builds(
        d.Entry, kind=st.sampled_from(["publisher", "subscriber", "server"]), topic=st.sampled_from(["a", "b", "c"]),
        types=st.just(("T",)), hashes=st.just(("00",)), endpoint=st.sampled_from(["tcp://1", "tcp://2"]),
    ),
    max_size=4,
).map(tuple)  # fmt: skip
HERE = "here"
COMPUTERS = dict(enumerate(("there", HERE, "afar", HERE, "there", HERE)))  # by incarnation
_INCARNATIONS = st.integers(1, 4)
_REASONS = st.sampled_from(["left", "lost", "silent", "forgotten", "unreachable"])
_MAYBE_ALIVE = ("silent", "forgotten", "unreachable")
_KINDS: tuple[d.Kind, ...] = ("publisher", "server")
_KEYS = [(kind, topic) for kind in _KINDS for topic in "abc"]


def _record(incarnation: int, entries: tuple[d.Entry, ...]) -> d.NodeRecord:
    return d.NodeRecord(f"node_{incarnation}", incarnation, 1, COMPUTERS[incarnation], 10 - incarnation, entries)


class Model(RuleBasedStateMachine):
    """Nodes come, change, go and are forgotten; every watch shows what a look at everybody would."""

    def __init__(self) -> None:
        super().__init__()
        self.neighbors = Neighbors(HERE)
        self.present: dict[int, tuple[d.Entry, ...]] = {}
        self.departed: dict[int, tuple[tuple[d.Entry, ...], bool]] = {}
        self.own: list[d.Entry] = []
        self.reported = dict.fromkeys(_KEYS, 0)
        self.seen: dict[tuple[d.Kind, str], tuple[tuple[Peer, ...], int]] = dict.fromkeys(_KEYS, ((), 0))
        self.watches: dict[tuple[d.Kind, str], Watch] = {}
        for kind, topic in _KEYS:
            self.watches[kind, topic] = Watch(kind, topic, partial(self._tell, (kind, topic)))
            self.neighbors.watch(self.watches[kind, topic])

    def _tell(self, key: tuple[d.Kind, str]) -> None:
        self.reported[key] += 1

    @rule(incarnation=_INCARNATIONS, entries=_ENTRIES)
    def put(self, incarnation: int, entries: tuple[d.Entry, ...]) -> None:
        self.neighbors.put(_record(incarnation, entries))
        self.departed.pop(incarnation, None)
        self.present[incarnation] = entries

    @rule(incarnation=_INCARNATIONS, reason=_REASONS)
    def depart(self, incarnation: int, reason: d.Reason) -> None:
        self.neighbors.depart(incarnation, reason)
        entries = self.present.pop(incarnation, None)
        if entries is None and incarnation in self.departed:
            entries = self.departed[incarnation][0]
        if entries is not None:
            self.departed[incarnation] = (entries, reason in _MAYBE_ALIVE)

    @rule(table=st.dictionaries(_INCARNATIONS, _ENTRIES), known=st.booleans())
    def replace(self, table: dict[int, tuple[d.Entry, ...]], known: bool) -> None:
        epoch = self.neighbors.epoch if known else self.neighbors.epoch + 1
        self.neighbors.replace([_record(i, entries) for i, entries in table.items()], epoch, 1)
        for incarnation in self.present.keys() - table.keys():
            self.departed[incarnation] = (self.present[incarnation], not known)
        self.present = dict(table)
        for incarnation in table:
            self.departed.pop(incarnation, None)

    @rule(entries=_ENTRIES)
    def add_own(self, entries: tuple[d.Entry, ...]) -> None:
        for entry in entries:
            self.neighbors.add_own(_record(5, ()), entry)
            self.own.append(entry)

    @precondition(lambda self: self.own)
    @rule(data=st.data())
    def remove_own(self, data: st.DataObject) -> None:
        entry = data.draw(st.sampled_from(self.own))
        self.neighbors.remove_own(entry)
        self.own.remove(entry)

    @rule()
    def forget(self) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("bifrost.neighbors.time.monotonic", lambda: 1e12)
            self.neighbors.forget_departed()
        self.departed.clear()

    @invariant()
    def every_watch_shows_what_is(self) -> None:
        self.neighbors.refresh()
        for (kind, topic), watch in self.watches.items():
            expected = {
                (incarnation, entry.endpoint, alive)
                for incarnation, entries, alive in (
                    *((i, entries, True) for i, entries in self.present.items()),
                    *((i, entries, alive) for i, (entries, alive) in self.departed.items()),
                    (5, tuple(self.own), True),
                )
                for entry in entries
                if (entry.kind, entry.topic) == (kind, topic) and (alive or kind == "publisher")
            }
            assert {(peer.incarnation, peer.entry.endpoint, peer.alive) for peer in watch.peers} == expected
            # Those in the table come last, on this computer the one started last at the end: it is the one to call.
            order = [
                (peer.incarnation not in self.departed, peer.computer == HERE, peer.computer, peer.started)
                for peer in watch.peers
            ]
            assert order == sorted(order)
            # Its owner is notified when, and only when, there is something new to see.
            before, reported = self.seen[kind, topic]
            assert (self.reported[kind, topic] > reported) == (watch.peers != before)
            self.seen[kind, topic] = (watch.peers, self.reported[kind, topic])


TestNeighbors = Model.TestCase
TestNeighbors.settings = settings(examples(60), stateful_step_count=25)
