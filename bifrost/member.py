"""A member of a network: what finds others for it, and what is made of it and ends with it."""

from __future__ import annotations

import re
import threading
from typing import Protocol, Self, TypeVar

import zmq

from bifrost import security, wire
from bifrost.discovery import Discovery
from bifrost.errors import Error, TimeoutError
from bifrost.graph import Graph
from bifrost.network import Network

_NAME = re.compile(r"[A-Za-z0-9_.~-]+(/[A-Za-z0-9_.~-]+)*")


class Closable(Protocol):
    """What is made of a member."""

    def close(self) -> None:
        """Give back everything; says so to the member by ``forget``."""


C = TypeVar("C", bound=Closable)


class Member:
    """What publishers, subscribers, servers and clients know of the node that they are made of.

    Attributes:
        name: what others see as origin.
        network: that it has joined.
        discovery: finds others, and lets this be found.
    """

    def __init__(self, name: str, network: Network | None, recall: bool) -> None:
        _check_name("node", name)
        self.name = name
        self.network = network or Network.from_environment()
        self._lock = threading.Lock()
        self._context = security.new_context()
        self._children: list[Closable] = []
        self._shared: list[zmq.Socket[bytes]] = []  # by several children; closed after them
        self._closed = False
        self.discovery = Discovery(self._context, self.network, name, recall)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def graph(self, timeout: float = 2.0) -> Graph:
        """Who publishes, subscribes to, serves and calls what now.

        Raises:
            TimeoutError: the daemon has not answered within ``timeout`` [s].
        """
        if not self.discovery.wait_change(lambda: self.discovery.registered, timeout):
            raise TimeoutError(f"{self.daemon_silent} (waited {timeout:g} s)")
        return Graph.from_records(self.discovery.records())

    def close(self) -> None:
        """Leave the network; close all that was made of this node. May be called twice.

        What was made of it must not be in use by another thread.
        """
        with self._lock:
            if self._closed:
                return
            self._closed = True
            children = list(self._children)
        for child in children:
            child.close()
        self.discovery.close()
        for socket in self._shared:
            socket.close()
        self._context.term()

    @property
    def daemon_silent(self) -> str:
        """What to tell a person when the daemon does not answer."""
        return f"bifrostd at {self.network.computer.daemon} does not answer"

    def forget(self, child: Closable) -> None:
        """A child has closed."""
        with self._lock:
            if child in self._children:
                self._children.remove(child)

    def _check(self, topic: str) -> None:
        if self._closed:
            raise Error(f"node {self.name} is closed")
        _check_name("topic", topic)

    def _keep(self, child: C) -> C:
        with self._lock:
            self._children.append(child)
        return child


def _check_name(what: str, name: str) -> None:
    if not _NAME.fullmatch(name) or len(name) > wire.MAX_NAME:
        raise ValueError(
            f"{what} name {name!r}: expected letters, digits, _, ., ~ and -, in parts separated by /, "
            f"at most {wire.MAX_NAME}"
        )
