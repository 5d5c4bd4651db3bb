"""A node: a process' place in the network."""

from __future__ import annotations

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
from bifrost.publisher import Latch, Outlet, Publisher
from bifrost.server import Server
from bifrost.subscriber import Drop, Subscriber

R = TypeVar("R", bound=Message)
_NAME = re.compile(r"[A-Za-z0-9_.~-]+(/[A-Za-z0-9_.~-]+)*")


class Node:
    """Publishes, subscribes, serves and calls under one name. A context manager.

    It needs no daemon to start: it is found, and finds others, as soon as one runs.

    Attributes:
        name: what others see as origin.
        network: that it has joined.
        discovery: finds others, and lets this be found.
    """

    def __init__(self, name: str, network: Network | None = None, *, recall: bool = False) -> None:
        """Join a network.

        Args:
            name: what others see as origin. Two nodes may share one.
            network: else ``Network.from_environment()``.
            recall: while no daemon has answered yet, find those that the last one has left on disk. They do not find
                this node: it may subscribe and call.

        Raises:
            ConfigurationError: the network file or the keys are missing or wrong.
            ValueError: no name for a node.
        """
        _check_name("node", name)
        self.name = name
        self.network = network or Network.from_environment()
        self._lock = threading.Lock()
        self._context = security.new_context()
        self._outlet: Outlet | None = None
        self._closed = False
        self.discovery = Discovery(self._context, self.network, name, recall)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def publisher(self, topic: str, message_type: type[M], latched: bool = False) -> Publisher[M]:
        """Publish on a topic.

        Args:
            topic: its name.
            message_type: what is published.
            latched: a subscriber that comes later gets the last message published before, as long as the publisher
                is open.

        Raises:
            ValueError: no name for a topic.
            TypeError: a field of the type is none that a message can have.
            Error: the topic is granted to somebody else.
        """
        self._check(topic)
        self._check_grant("publisher", topic)
        host = self.network.computer.host
        if latched:
            codec(message_type)  # a type that no message can have is refused before anything is opened
            latch = Latch(self.discovery.listening_socket(zmq.XPUB), host, topic, self.discovery)
            return Publisher(self.discovery, latch, topic, message_type)
        with self._lock:
            if self._outlet is None:
                self._outlet = Outlet(self.discovery.listening_socket(zmq.PUB), host)
            outlet = self._outlet
        return Publisher(self.discovery, outlet, topic, message_type)

    def subscriber(
        self,
        topic: str,
        message_type: type[M],
        queue: int | None = None,
        drop: Drop = "newest",
        limit: Limit | None = None,
    ) -> Subscriber[M]:
        """Subscribe to a topic.

        Args:
            topic: its name; the publisher may come before or after.
            message_type: publishers of another are refused, see ``Subscriber.mismatches``.
            queue: None: the newest message only. Otherwise every message, this many held at least; what is more is
                dropped and counted.
            drop: of a full queue, the newest: what comes is not taken; or the oldest: a thread of the subscriber takes
                what comes and lets go of what has waited longest.
            limit: of each publisher; one that goes on beyond it is muted, see ``Subscriber.muted``. By default none.
        """
        self._check(topic)
        if queue is not None and queue < 1:
            raise ValueError(f"{topic}: queue: expected at least 1, got {queue}")
        if drop not in ("newest", "oldest"):
            raise ValueError(f"{topic}: drop: expected newest or oldest, got {drop!r}")
        if drop == "oldest" and queue is None:
            raise ValueError(f"{topic}: drop: expected a queue to drop the oldest of")
        return Subscriber(self.discovery, topic, message_type, queue, drop, limit=limit)

    def subscribe_any(self, topic: str, queue: int | None = None) -> Subscriber[Message]:
        """Subscribe to a topic whatever its type: decoded by the schema that its publisher has registered."""
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
        """Serve a topic: ``handler(request, origin)`` returns the reply, called from ``Server.serve``.

        Of each client more than ``limit`` is not answered, see ``Server.muted``.

        Raises:
            Error: the topic is granted to somebody else.
        """
        self._check(topic)
        self._check_grant("server", topic)
        return Server(self.discovery, topic, request, reply, handler, limit=limit)

    def client(self, topic: str, request: type[M], reply: type[R]) -> Client[M, R]:
        """Call the server of a topic."""
        self._check(topic)
        return Client(self.discovery, topic, request, reply)

    def graph(self, timeout: float = 2.0) -> Graph:
        """Who publishes, subscribes to, serves and calls what now.

        Raises:
            TimeoutError: the daemon has not answered within ``timeout`` [s].
        """
        if not self.discovery.wait_change(lambda: self.discovery.registered, timeout):
            raise TimeoutError(f"{self.discovery.daemon_silent} (waited {timeout:g} s)")
        return Graph.from_records(self.discovery.records())

    def close(self) -> None:
        """Leave the network; close all that was made of this node. May be called twice.

        What was made of it must not be in use by another thread.
        """
        with self._lock:
            if self._closed:
                return
            self._closed = True
        for owner in self.discovery.owners:
            owner.close()
        self.discovery.close()
        if self._outlet is not None:
            self._outlet.socket.close()
        self._context.term()

    def _check(self, topic: str) -> None:
        if self._closed:
            raise Error(f"node {self.name} is closed")
        _check_name("topic", topic)

    def _check_grant(self, kind: str, topic: str) -> None:
        if refusal := self.network.grants.refusal(self.name, kind, topic, self.network.owner):
            raise Error(refusal)


def _check_name(what: str, name: str) -> None:
    if not _NAME.fullmatch(name) or len(name) > wire.MAX_NAME:
        raise ValueError(
            f"{what} name {name!r}: expected letters, digits, _, ., ~ and -, in parts separated by /, "
            f"at most {wire.MAX_NAME}"
        )
