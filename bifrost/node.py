"""A node: a process' place in the network."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import zmq

from bifrost.client import Client
from bifrost.encoding import codec
from bifrost.errors import Error
from bifrost.limits import Limit
from bifrost.member import Member
from bifrost.messages import M, Message
from bifrost.network import Network
from bifrost.publisher import Latch, Outlet, Publisher
from bifrost.server import Server
from bifrost.subscriber import Drop, Subscriber

R = TypeVar("R", bound=Message)


class Node(Member):
    """Publishes, subscribes, serves and calls under one name. A context manager.

    It needs no daemon to start: it is found, and finds others, as soon as one runs.
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
        super().__init__(name, network, recall)
        self._outlet: Outlet | None = None

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
            return self._keep(Publisher(self, latch, topic, message_type))
        with self._lock:
            if self._outlet is None:
                self._outlet = Outlet(self.discovery.listening_socket(zmq.PUB), host)
                self._shared.append(self._outlet.socket)
            outlet = self._outlet
        return self._keep(Publisher(self, outlet, topic, message_type))

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
        return self._keep(Subscriber(self, topic, message_type, queue, drop, limit=limit))

    def subscribe_any(self, topic: str, queue: int | None = None) -> Subscriber[Message]:
        """Subscribe to a topic whatever its type: decoded by the schema that its publisher has registered."""
        self._check(topic)
        return self._keep(Subscriber[Message](self, topic, None, queue))

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
        return self._keep(Server(self, topic, request, reply, handler, limit=limit))

    def client(self, topic: str, request: type[M], reply: type[R]) -> Client[M, R]:
        """Call the server of a topic."""
        self._check(topic)
        return self._keep(Client(self, topic, request, reply))

    def _check_grant(self, kind: str, topic: str) -> None:
        if refusal := self.network.grants.refusal(self.name, kind, topic, self.network.owner):
            raise Error(refusal)
