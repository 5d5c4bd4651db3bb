"""A Bifrost node in an instance's network, and what verbs do with it alike: hear the next message, ask a service."""

from __future__ import annotations

from typing import TypeVar

import bifrost
from valor.common import membership
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.topics import ServiceTopic, Topic

M = TypeVar("M", bound=bifrost.Message)
Q = TypeVar("Q", bound=bifrost.Message)
R = TypeVar("R", bound=bifrost.Message)


def join(instance: Instance, name: str = "valorctl", owner: str = "") -> bifrost.Node:
    """A node; names and errors as of ``membership.network``. A context manager."""
    return bifrost.Node(name, network=membership.network(instance, owner))


def hear(topic: Topic[M], subscriber: bifrost.Subscriber[M], timeout: float) -> M:
    """The next message.

    Raises:
        ValorError: none within ``timeout`` [s]; names who is silent.
    """
    received = subscriber.receive(timeout=timeout)
    if received is None:
        raise ValorError(f"{topic.owner} is silent: no {topic.name} within {timeout:g} s")
    return received.message


def ask(instance: Instance, service: ServiceTopic[Q, R], request: Q, timeout: float, nobody: str) -> R:
    """Send a request and wait for its reply.

    Args:
        instance: must be up.
        service: to be asked.
        request: to send.
        timeout: for the reply [s].
        nobody: what it means that nobody serves it.

    Raises:
        ValorError: nobody serves it.
    """
    with join(instance) as node:
        try:
            return service.client(node).call(request, timeout=timeout)
        except bifrost.NoServerError:
            raise ValorError(f"nobody serves {service.name}: {nobody}") from None
