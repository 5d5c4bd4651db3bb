"""Exclusive rights to publish topics and serve services, and their proof.

An owner is a process with its own CURVE key pair, with which it listens and connects: the handshake proves its identity
to subscribers, clients and daemons. The network file contains its public key, topics and services. Registrations with
the network's common keys, or another owner's, are rejected.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

DAEMON = "bifrostd"  # owner of every daemon of a network with owners
MEMBER = "member"  # any process that has only the common keys
_VERB = {"publisher": "publish", "server": "serve"}


@dataclass(frozen=True)
class AccessPolicy:
    """Rights to grant when a network is created, with new keys for the owners."""

    folder: Path  # of the owners' key pairs: <folder>/<owner>/own.key, for its process only
    publishers: Mapping[str, Sequence[str]]  # names of owners by topic
    servers: Mapping[str, Sequence[str]] = field(default_factory=dict)  # names of owners by service

    @property
    def owners(self) -> tuple[str, ...]:
        """All owners, the daemon included."""
        named = {name for table in (self.publishers, self.servers) for names in table.values() for name in names}
        return (DAEMON, *sorted(named - {DAEMON}))


@dataclass(frozen=True)
class Grants:
    """Rights in a network, from its file; empty in a network without owners."""

    owners: Mapping[str, str] = field(default_factory=dict)  # public keys, Z85, by name
    publishers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # owners by topic
    servers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # owners by service

    def plain(self) -> dict[str, Any]:
        """Content for the network file; empty without owners."""
        tables = {"owners": self.owners, "publishers": self.publishers, "servers": self.servers}
        return {name: dict(table) for name, table in tables.items()} if self.owners else {}

    def owner_of(self, key: str) -> str:
        """Name of the owner of a public key; ``MEMBER`` for all other keys."""
        return next((name for name, owned in self.owners.items() if owned == key), MEMBER)

    @property
    def daemon(self) -> str:
        """Identity that a daemon must prove: its owner; without owners, a member."""
        return DAEMON if self.owners else MEMBER

    def refusal(self, who: str, kind: str, topic: str, proven: str) -> str:
        """Reason why a node may not have a publisher or server; empty: it may.

        ``who``: its claimed name; ``kind``, ``topic``: of the entry; ``proven``: proven owner, or ``MEMBER``.
        """
        owners = {"publisher": self.publishers, "server": self.servers}.get(kind, {}).get(topic)
        if owners is None or proven in owners:
            return ""
        return f"{who} may not {_VERB[kind]} {topic}, which belongs to {' or '.join(owners)}"


NONE = Grants()
"""No rights are exclusive: all members may publish and serve all topics."""
