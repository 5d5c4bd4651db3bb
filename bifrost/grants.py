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

DAEMON = "bifrostd"  # the owner that every daemon of a network with owners is
MEMBER = "member"  # whoever has the common keys alone
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


NONE = Grants()
"""Nothing is granted: everybody may publish and serve everything."""
