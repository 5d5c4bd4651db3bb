"""Who alone may publish a topic or serve a service, and how that is proven.

A network may have owners: processes with a CURVE key pair of their own, whose public keys stand in the network file
together with the topics and services that are theirs. An owner listens and connects with its own key. So the handshake
proves to a subscriber that its publisher is who it should be, and to the daemon who registers; whoever has only the
network's common keys, or another owner's, is refused by name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from bifrost.directory import Entry, NodeRecord
from bifrost.errors import ConfigurationError

DAEMON = "bifrostd"  # the owner that every daemon of a network with owners is
MEMBER = "member"  # whoever has the common keys alone
_KEY_LENGTH = 40  # Z85 text of a CURVE key
_WISH = {"publisher": "publish", "server": "serve"}


@dataclass(frozen=True)
class Charter:
    """What is granted to whom when a network is created; their keys are issued then.

    Attributes:
        folder: where each owner's key pair goes: ``<folder>/<owner>/own.key``, for its process alone.
        publishers: topic to the names of those who may publish it.
        servers: service to the names of those who may serve it.
    """

    folder: Path
    publishers: Mapping[str, Sequence[str]]
    servers: Mapping[str, Sequence[str]] = field(default_factory=dict)

    @property
    def owners(self) -> tuple[str, ...]:
        """All who are named, and the daemon."""
        named = {name for table in (self.publishers, self.servers) for names in table.values() for name in names}
        return (DAEMON, *sorted(named - {DAEMON}))


@dataclass(frozen=True)
class Grants:
    """What is granted to whom, as all members know it; of a network without owners nothing is.

    Attributes:
        owners: name to public key, Z85.
        publishers: topic to the names of those who may publish it.
        servers: service to the names of those who may serve it.
    """

    owners: Mapping[str, str] = field(default_factory=dict)
    publishers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    servers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @classmethod
    def read(cls, content: Mapping[str, Any], where: Path) -> Grants:
        """Those of a network file.

        Raises:
            ConfigurationError: they are not what is expected.
        """
        try:
            grants = cls(
                msgspec.convert(content.get("owners", {}), dict[str, str]),
                msgspec.convert(content.get("publishers", {}), dict[str, tuple[str, ...]]),
                msgspec.convert(content.get("servers", {}), dict[str, tuple[str, ...]]),
            )
        except msgspec.ValidationError as error:
            raise ConfigurationError(f"{where}: owners, publishers, servers: {error}") from None
        for name, key in grants.owners.items():
            if len(key) != _KEY_LENGTH:
                raise ConfigurationError(f"{where}: owners.{name}: expected a public key of {_KEY_LENGTH} characters")
        for table, topics in (("publishers", grants.publishers), ("servers", grants.servers)):
            for topic, names in topics.items():
                if not names or not grants.owners.keys() >= set(names):
                    raise ConfigurationError(f"{where}: {table}.{topic}: expected names of owners, got {list(names)}")
        return grants

    def plain(self) -> dict[str, Any]:
        """As the network file has them; nothing, if nothing is granted."""
        if not self.owners:
            return {}
        tables = {"publishers": self.publishers, "servers": self.servers}
        return {"owners": dict(self.owners)} | {
            name: {topic: list(owners) for topic, owners in table.items()} for name, table in tables.items()
        }

    def owner_of(self, key: str) -> str:
        """Whose a public key is; a member's, if no owner's."""
        return next((name for name, owned in self.owners.items() if owned == key), MEMBER)

    @property
    def daemon(self) -> str:
        """Who a daemon has to prove to be: its owner, or without owners a member."""
        return DAEMON if self.owners else MEMBER

    def refusal(self, who: str, kind: str, topic: str, proven: str) -> str:
        """Why a node may not have a publisher or server; an empty text: it may.

        Args:
            who: its name, as it calls itself.
            kind: of the entry.
            topic: its name.
            proven: the owner that it has proven to be, or ``MEMBER``.
        """
        owners = {"publisher": self.publishers, "server": self.servers}.get(kind, {}).get(topic)
        if owners is None or proven in owners:
            return ""
        return f"{who} wants to {_WISH[kind]} {topic}, which is {' or '.join(owners)}'s"

    def sift(self, record: NodeRecord, proven: str | None = None) -> tuple[NodeRecord, list[str]]:
        """A record without what its node may not have, and why that is refused.

        Args:
            record: of the node.
            proven: the owner that its connection has proven it to be; None: nothing is known of that, and the keys that
                it announces count. A false one is found out by whoever connects.
        """
        if not self.owners:
            return record, []
        kept: list[Entry] = []
        refusals = []
        for entry in record.entries:
            owner = self.owner_of(entry.key)
            shown = owner if proven is None or proven == owner else MEMBER
            if refusal := self.refusal(record.name, entry.kind, entry.topic, shown):
                refusals.append(f"{refusal}: refused")
            else:
                kept.append(entry)
        return (msgspec.structs.replace(record, entries=tuple(kept)) if refusals else record), refusals


NONE = Grants()
"""Nothing is granted: everybody may publish and serve everything."""
