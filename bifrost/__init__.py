"""Bifrost: publish–subscribe and request–reply between processes that find each other by topic name alone."""

from bifrost.client import Client
from bifrost.directory import DaemonInfo
from bifrost.encoding import codec
from bifrost.errors import ConfigurationError, Error, NoServerError, RemoteError, SchemaError, TimeoutError
from bifrost.grants import AccessPolicy, Grants
from bifrost.graph import Graph, daemon_alive
from bifrost.limits import Limit
from bifrost.messages import Float64Array, Message, Uint8Array
from bifrost.network import Computer, Network
from bifrost.node import Node
from bifrost.publisher import Publisher
from bifrost.reflection import from_json, to_builtins
from bifrost.server import Server
from bifrost.subscriber import Received, Subscriber
from bifrost.waiting import Poller, wait

__all__ = [
    "AccessPolicy",
    "Client",
    "Computer",
    "ConfigurationError",
    "DaemonInfo",
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
    "SchemaError",
    "Server",
    "Subscriber",
    "TimeoutError",
    "Uint8Array",
    "codec",
    "daemon_alive",
    "from_json",
    "to_builtins",
    "wait",
]
