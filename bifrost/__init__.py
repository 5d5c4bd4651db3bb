"""Bifrost: publish–subscribe and request–reply between processes that find each other by topic name alone."""

from bifrost.client import Client
from bifrost.directory import Count, DaemonInfo
from bifrost.encoding import codec
from bifrost.errors import (
    ConfigurationError,
    Error,
    NoServerError,
    RemoteError,
    SchemaError,
    TimeoutError,
)
from bifrost.grants import Charter, Grants
from bifrost.graph import End, Graph, ServiceInfo, TopicInfo
from bifrost.health import counts, daemon_alive
from bifrost.limits import Limit
from bifrost.messages import Float64Array, Message, Uint8Array
from bifrost.network import Computer, Network
from bifrost.node import Node
from bifrost.plain import from_builtins, to_builtins
from bifrost.publisher import Publisher
from bifrost.reflection import type_from_schema
from bifrost.schema import Schema
from bifrost.server import Server
from bifrost.subscriber import Received, Subscriber
from bifrost.waiting import Poller, wait

__all__ = [
    "Charter",
    "Client",
    "Computer",
    "ConfigurationError",
    "Count",
    "DaemonInfo",
    "End",
    "Error",
    "Float64Array",
    "Grants",
    "Graph",
    "Limit",
    "Message",
    "Network",
    "NoServerError",
    "Node",
    "Poller",
    "Publisher",
    "Received",
    "RemoteError",
    "Schema",
    "SchemaError",
    "Server",
    "ServiceInfo",
    "Subscriber",
    "TimeoutError",
    "TopicInfo",
    "Uint8Array",
    "codec",
    "counts",
    "daemon_alive",
    "from_builtins",
    "to_builtins",
    "type_from_schema",
    "wait",
]
