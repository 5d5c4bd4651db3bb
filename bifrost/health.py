"""What daemons tell whoever asks: how they fare, and what has passed the ends of a topic."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TypeVar

import msgspec
import zmq

from bifrost import directory as d
from bifrost.network import Computer, Network
from bifrost.security import connect, connecting_socket

A = TypeVar("A", bound=d.FromDaemon)


def daemon_alive(network: Network, timeout: float = 1.0) -> d.DaemonInfo | None:
    """Ask this computer's daemon how it fares; None when it does not answer within ``timeout`` [s]."""
    answers = _ask(network, [network.computer], d.Ask(), d.DaemonInfo, timeout)
    return answers[0] if answers else None


def counts(network: Network, topic: str, timeout: float = 1.0) -> dict[int, list[d.Count]]:
    """What has passed the ends of a topic, by the incarnation of the node, in the order in which it made them.

    Every node tells its daemon once a second; all computers' daemons are asked, and those that do not answer within
    ``timeout`` [s] are left out.
    """
    answers = _ask(network, network.computers, d.AskCounts(topic), d.Counts, timeout)
    return {incarnation: counts for answer in answers for incarnation, counts in answer.counts.items()}


def _ask(
    network: Network, computers: Sequence[Computer], question: d.ToDaemon, answer: type[A], timeout: float
) -> list[A]:
    """Ask several daemons at once; the answers of those that gave one."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    sockets = [connecting_socket(context, zmq.DEALER, network) for _ in computers]
    answers: list[A] = []
    try:
        for socket, computer in zip(sockets, computers, strict=True):
            connect(socket, computer.daemon, network.daemon_key)
            socket.send(d.encode(question))
        deadline = time.monotonic() + timeout
        for socket in sockets:
            while socket.poll(max(0, int((deadline - time.monotonic()) * 1000))):
                try:
                    message = d.decode_from_daemon(socket.recv())
                except (msgspec.DecodeError, RecursionError):
                    continue  # of another version
                if isinstance(message, answer):
                    answers.append(message)
                    break
        return answers
    finally:
        for socket in sockets:
            socket.close()
        context.term()
