"""Grants: exactly those of the tables, also after a round trip through the network file."""

import json
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from bifrost import AccessPolicy, Grants
from bifrost.directory import Entry, NodeRecord
from bifrost.grants import DAEMON, MEMBER
from bifrost.network import read_grants
from harness.examples import examples

NAMES = ("arm", "eye", DAEMON)
KEYS = {name: str(i) * 40 for i, name in enumerate(NAMES)}
TOPICS = ("a", "b", "c")
KINDS = ("publisher", "subscriber", "server", "client")

tables = st.dictionaries(
    st.sampled_from(TOPICS), st.lists(st.sampled_from(NAMES), min_size=1, max_size=2, unique=True).map(tuple)
)
entries = st.builds(
    lambda kind, topic, key: Entry(kind, topic, (), (), key=key),
    st.sampled_from(KINDS), st.sampled_from(TOPICS), st.sampled_from([*KEYS.values(), "", "x" * 40]),
)  # fmt: skip


def whose(key: str) -> str:
    return next((name for name, owned in KEYS.items() if owned == key), MEMBER)


@given(tables, tables, st.lists(entries, max_size=6).map(tuple), st.sampled_from([*NAMES, MEMBER, None]))
@examples(150)
def test_a_node_keeps_what_it_may_have_and_each_refusal_is_reported(
    publishers: dict[str, tuple[str, ...]],
    servers: dict[str, tuple[str, ...]],
    announced: tuple[Entry, ...],
    proven: str | None,
) -> None:
    grants = Grants(KEYS, publishers, servers)
    record = NodeRecord("node", 1, 1, "near", 1, announced)
    kept, refusals = [], []
    for entry in announced:
        owners = {"publisher": publishers, "server": servers}.get(entry.kind, {}).get(entry.topic)
        # A key counts as announced where nothing is proven, and as the proven owner's alone where something is.
        shown = whose(entry.key) if proven is None or proven == whose(entry.key) else MEMBER
        if owners is None or shown in owners:
            kept.append(entry)
        else:
            verb = "publish" if entry.kind == "publisher" else "serve"
            refusals.append(f"node may not {verb} {entry.topic}, which belongs to {' or '.join(owners)}: rejected")
    sifted, reported = record.sifted(grants, proven)
    assert (sifted.entries, reported) == (tuple(kept), refusals) and (sifted is record) == (not refusals)


@given(tables, tables)
@examples(50)
def test_grants_are_the_same_through_the_network_file(
    publishers: dict[str, tuple[str, ...]], servers: dict[str, tuple[str, ...]]
) -> None:
    grants = Grants(KEYS, publishers, servers)
    assert read_grants(json.loads(json.dumps(grants.plain())), Path("network.json")) == grants
    assert grants.daemon == DAEMON and [grants.owner_of(key) for key in (*KEYS.values(), "")] == [*NAMES, MEMBER]
    named = {name for owners in (*publishers.values(), *servers.values()) for name in owners}
    assert AccessPolicy(Path(), publishers, servers).owners == (DAEMON, *sorted(named - {DAEMON}))


def test_without_owners_everything_is_everybodys() -> None:
    record = NodeRecord("node", 1, 1, "near", 1, (Entry("publisher", "a", (), ()),))
    assert record.sifted(Grants(), MEMBER) == (record, []) and (Grants().plain(), Grants().daemon) == ({}, MEMBER)
