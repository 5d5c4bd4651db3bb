"""A node: the access of a process to the network."""

import re
import threading
from collections.abc import Callable
from typing import Self, TypeVar

import zmq

from bifrost import security, wire
from bifrost.client import Client
from bifrost.discovery import Discovery
from bifrost.encoding import codec
from bifrost.errors import Error, TimeoutError
from bifrost.graph import Graph
from bifrost.limits import Limit
from bifrost.messages import M, Message
from bifrost.network import Network
from bifrost.publisher import Latch, Publisher, PublisherSocket
from bifrost.server import Server
from bifrost.subscriber import Subscriber

R = TypeVar("R", bound=Message)
_NAME = re.compile(r"[A-Za-z0-9_.~-]+(/[A-Za-z0-9_.~-]+)*")


class Node:
    """Publishes, subscribes, serves and calls under one name, as soon as a daemon runs. A context manager.

    Attributes:
        name: origin of its messages.
        network: that it has joined.
        discovery: its connection to the daemon.
    """

    def __init__(self, name: str, network: Network | None = None, *, recall: bool = False) -> None:
        """Join a network.

        Args:
            name: origin of its messages; not unique.
            network: default ``Network.from_environment()``.
            recall: until a daemon responds, find the nodes of the last daemon's table on disk. These do not find this
                node: it can only subscribe and call.

        Raises:
            ConfigurationError: the network file or the keys are missing or wrong.
            ValueError: invalid name.
        """
        check_name("node", name)
        self.name = name
        self.network = network or Network.from_environment()
        self._lock = threading.Lock()
        self._context = security.new_context()
        self._socket: PublisherSocket | None = None
        self._closed = False
        self.discovery = Discovery(self._context, self.network, name, recall)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def publisher(self, topic: str, message_type: type[M], latched: bool = False) -> Publisher[M]:
        """Publish on a topic; ``latched``: later subscribers get the last message while the publisher is open.

        Raises:
            ValueError: invalid name.
            TypeError: a field of the type is not supported.
            Error: the topic belongs to another owner.
        """
        self._check(topic)
        self._check_grant("publisher", topic)
        host = self.network.computer.host
        if latched:
            codec(message_type)  # rejects unsupported types before a socket is opened
            latch = Latch(self.discovery.listening_socket(zmq.XPUB), host, topic, self.discovery)
            return Publisher(self.discovery, latch, topic, message_type)
        with self._lock:
            if self._socket is None:
                self._socket = PublisherSocket(self.discovery.listening_socket(zmq.PUB), host)
            socket = self._socket
        return Publisher(self.discovery, socket, topic, message_type)

    def subscriber(
        self, topic: str, message_type: type[M], queue: int | None = None, limit: Limit | None = None
    ) -> Subscriber[M]:
        """Subscribe to a topic.

        Args:
            topic: its name; publishers may start before or after.
            message_type: publishers of another type are not connected, with a warning in the log.
            queue: None: the latest message only. Otherwise the minimum length of the queue; further messages are
                dropped and counted.
            limit: of each publisher; one that exceeds it is muted (``Subscriber.muted``). Default: none.
        """
        self._check(topic)
        if queue is not None and queue < 1:
            raise ValueError(f"{topic}: queue: expected at least 1, got {queue}")
        return Subscriber(self.discovery, topic, message_type, queue, limit=limit)

    def subscribe_any(self, topic: str, queue: int | None = None) -> Subscriber[Message]:
        """Subscribe to a topic of any type, decoded by the schema that its publisher has registered."""
        self._check(topic)
        return Subscriber[Message](self.discovery, topic, None, queue)

    def server(
        self,
        topic: str,
        request: type[M],
        reply: type[R],
        handler: Callable[[M, str], R],
        limit: Limit | None = None,
    ) -> Server[M, R]:
        """Serve a topic: ``handler(request, origin)``, called from ``Server.serve``, returns the reply.

        Clients that exceed ``limit`` get no reply (``Server.muted``). Raises Error: the topic belongs to another owner.
        """
        self._check(topic)
        self._check_grant("server", topic)
        return Server(self.discovery, topic, request, reply, handler, limit=limit)

    def client(self, topic: str, request: type[M], reply: type[R]) -> Client[M, R]:
        """Call the server of a topic."""
        self._check(topic)
        return Client(self.discovery, topic, request, reply)

    def graph(self, timeout: float = 2.0) -> Graph:
        """All topics and services with their nodes. Raises TimeoutError: no reply of the daemon in ``timeout`` [s]."""
        if not self.discovery.wait_change(lambda: self.discovery.registered, timeout):
            raise TimeoutError(f"{self.discovery.daemon_silent} (waited {timeout:g} s)")
        return Graph.from_records(self.discovery.records())

    def close(self) -> None:
        """Leave the network; close all that the node has made, which no thread may use. May be called twice."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        for owner in self.discovery.owners:
            owner.close()
        self.discovery.close()
        if self._socket is not None:
            self._socket.socket.close()
        self._context.term()

    def _check(self, topic: str) -> None:
        if self._closed:
            raise Error(f"node {self.name} is closed")
        check_name("topic", topic)

    def _check_grant(self, kind: str, topic: str) -> None:
        if refusal := self.network.grants.refusal(self.name, kind, topic, self.network.owner):
            raise Error(refusal)


def check_name(what: str, name: str) -> None:
    """Raise ``ValueError`` if a name of a topic or node is invalid."""
    if not _NAME.fullmatch(name) or len(name) > wire.MAX_NAME:
        raise ValueError(
            f"{what} name {name!r}: expected letters, digits, _, ., ~ and -, in parts separated by /, "
            f"at most {wire.MAX_NAME}"
        )
