"""The network as a picture: topics and services with who is at either end."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from bifrost.directory import Entry, NodeRecord
from bifrost.schema import Schema


@dataclass(frozen=True)
class End:
    """A node at one end of a topic."""

    node: str
    pid: int
    computer: str
    types: tuple[str, ...]  # of a topic one; of a service request and reply; empty: any
    hashes: tuple[str, ...]
    endpoint: str  # empty for those that connect
    incarnation: int  # of the node
    latched: bool  # of a publisher


@dataclass
class TopicInfo:
    """A publish–subscribe topic."""

    name: str
    publishers: list[End] = field(default_factory=list)
    subscribers: list[End] = field(default_factory=list)

    @property
    def types(self) -> list[str]:
        """Names of the message types in use; more than one is somebody's mistake."""
        return sorted({name for end in (*self.publishers, *self.subscribers) for name in end.types})


@dataclass
class ServiceInfo:
    """A request–reply topic."""

    name: str
    servers: list[End] = field(default_factory=list)
    clients: list[End] = field(default_factory=list)


@dataclass(frozen=True)
class Graph:
    """Everything the daemon knows, by name."""

    nodes: list[str]
    topics: dict[str, TopicInfo]
    services: dict[str, ServiceInfo]
    schemas: dict[str, Schema]  # by hash

    @classmethod
    def from_records(cls, records: Iterable[NodeRecord]) -> Graph:
        """Turn the table around: from nodes with topics to topics with nodes."""
        graph = cls([], {}, {}, {})
        for record in sorted(records, key=lambda record: (record.name, record.computer, record.started)):
            graph.nodes.append(record.name)
            graph.schemas.update(record.schemas)
            for entry in record.entries:
                graph._add(record, entry)
        return cls(graph.nodes, dict(sorted(graph.topics.items())), dict(sorted(graph.services.items())), graph.schemas)

    def _add(self, record: NodeRecord, entry: Entry) -> None:
        end = End(
            record.name,
            record.pid,
            record.computer,
            entry.types,
            entry.hashes,
            entry.endpoint,
            record.incarnation,
            entry.latched,
        )
        if entry.kind in ("publisher", "subscriber"):
            topic = self.topics.setdefault(entry.topic, TopicInfo(entry.topic))
            (topic.publishers if entry.kind == "publisher" else topic.subscribers).append(end)
        else:
            service = self.services.setdefault(entry.topic, ServiceInfo(entry.topic))
            (service.servers if entry.kind == "server" else service.clients).append(end)
