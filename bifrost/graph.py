"""State of the network: topics and services with the nodes at their ends; status of the daemon."""

import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Self

import zmq

from bifrost import directory as d
from bifrost.messages import Schema
from bifrost.network import Network
from bifrost.security import connect, connecting_socket

_SHOWN = ("node", "pid", "computer", "types", "hashes", "endpoint", "latched")  # of an end, in JSON


@dataclass(frozen=True)
class End:
    """A node at one end of a topic."""

    node: str
    pid: int
    computer: str
    types: tuple[str, ...]  # one of a topic; request and reply of a service; empty: any
    hashes: tuple[str, ...]
    endpoint: str  # empty for ends that connect
    incarnation: int  # of the node
    latched: bool  # of a publisher


@dataclass
class _Info:
    name: str

    @property
    def ends(self) -> dict[str, list[End]]:
        """The ends by kind."""
        return {kind: ends for kind, ends in vars(self).items() if kind != "name"}

    @property
    def types(self) -> list[str]:
        """Names of the message types in use; more than one is an error."""
        return sorted({" -> ".join(end.types) for ends in self.ends.values() for end in ends if end.types})


@dataclass
class TopicInfo(_Info):
    """A publish–subscribe topic."""

    publishers: list[End] = field(default_factory=list)
    subscribers: list[End] = field(default_factory=list)


@dataclass
class ServiceInfo(_Info):
    """A request–reply topic."""

    servers: list[End] = field(default_factory=list)
    clients: list[End] = field(default_factory=list)


@dataclass(frozen=True)
class Graph:
    """The daemon's table by name."""

    nodes: list[str]
    topics: dict[str, TopicInfo]
    services: dict[str, ServiceInfo]
    schemas: dict[str, Schema]  # by hash

    @classmethod
    def from_records(cls, records: Iterable[d.NodeRecord]) -> Self:
        """Convert the table of nodes with topics to topics with nodes."""
        graph = cls([], {}, {}, {})
        for record in sorted(records, key=lambda record: (record.name, record.computer, record.started)):
            graph.nodes.append(record.name)
            graph.schemas.update(record.schemas)
            for entry in record.entries:
                graph._add(record, entry)
        return cls(graph.nodes, dict(sorted(graph.topics.items())), dict(sorted(graph.services.items())), graph.schemas)

    def as_json(self, info: TopicInfo | ServiceInfo) -> dict[str, Any]:
        """A topic or service with its types, its schemas, and its ends by kind."""
        hashes = sorted({digest for ends in info.ends.values() for end in ends for digest in end.hashes})
        schemas = {each: {"name": self.schemas[each].name, "types": self.schemas[each].types} for each in hashes}
        shown = {
            kind: [{key: getattr(end, key) for key in _SHOWN} | {"endpoint": end.endpoint or None} for end in ends]
            for kind, ends in info.ends.items()
        }
        return {"name": info.name, "types": info.types, "schemas": schemas} | shown

    def _add(self, record: d.NodeRecord, entry: d.Entry) -> None:
        end = End(
            record.name, record.pid, record.computer, entry.types, entry.hashes, entry.endpoint, record.incarnation,
            entry.latched,
        )  # fmt: skip
        if entry.kind in ("publisher", "subscriber"):
            topic = self.topics.setdefault(entry.topic, TopicInfo(entry.topic))
            (topic.publishers if entry.kind == "publisher" else topic.subscribers).append(end)
        else:
            service = self.services.setdefault(entry.topic, ServiceInfo(entry.topic))
            (service.servers if entry.kind == "server" else service.clients).append(end)


def daemon_alive(network: Network, timeout: float = 1.0) -> d.DaemonInfo | None:
    """Status of this computer's daemon; None without a reply within ``timeout`` [s]."""
    with zmq.Context() as context, connecting_socket(context, zmq.DEALER, network) as socket:
        connect(socket, network.computer.daemon, network.daemon_key)
        socket.send(d.encode(d.Ask()))
        deadline = time.monotonic() + timeout
        while socket.poll(max(0, int((deadline - time.monotonic()) * 1000))):
            for message in d.from_daemon(socket):
                if isinstance(message, d.DaemonInfo):
                    return message
    return None
