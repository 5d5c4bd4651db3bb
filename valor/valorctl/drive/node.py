"""Bifrost node of a verb: joins an instance's network, receives a message, calls a service."""

from typing import Any, TypeVar

import bifrost
from valor.common import topics
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.topics import ServiceTopic, Topic

M = TypeVar("M", bound=bifrost.Message)
Q = TypeVar("Q", bound=bifrost.Message)
R = TypeVar("R", bound=bifrost.Message)


def join(instance: Instance, name: str = "valorctl", owner: str = "") -> bifrost.Node:
    """Return a node, to be used as a context manager; ``owner`` and errors as of ``topics.network``."""
    return bifrost.Node(name, network=topics.network(instance, owner))


def next_message(topic: Topic[M], subscriber: bifrost.Subscriber[M], timeout: float) -> M:
    """Return the next message; raises ``ValorError`` with the publisher's name after ``timeout`` [s]."""
    received = subscriber.receive(timeout=timeout)
    if received is None:
        raise ValorError(f"no {topic.name} from {topic.owner} within {timeout:g} s; see `valorctl status`")
    return received.message


def request(
    instance: Instance, service: ServiceTopic[Q, R], message: Q, *, timeout: float, action: str, needs: str
) -> R:
    """Call a service whose reply has ``accepted`` and ``reason``; raises ``ValorError`` if it is absent or rejects.

    ``action`` and ``needs`` name the request and its server in the error message.
    """
    with join(instance) as node:
        try:
            reply = service.client(node).call(message, timeout=timeout)
        except bifrost.NoServerError:
            raise ValorError(f"no process serves {service.name}: {needs}") from None
    answer: Any = reply
    if not answer.accepted:
        raise ValorError(f"{action} rejected: {answer.reason}")
    return reply
