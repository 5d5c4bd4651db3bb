"""One loop over many subscribers and servers."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Protocol, TypeVar

import zmq


class Waitable(Protocol):
    """What ``wait`` waits for: a subscriber or a server."""

    socket: zmq.Socket[bytes]

    def ready(self) -> bool:
        """Whether something waits."""
        ...


W = TypeVar("W", bound=Waitable)


def wait(items: Sequence[W], timeout: float | None = None) -> list[W]:
    """Wait until one of several subscribers and servers has something.

    Args:
        items: subscribers and servers, of one or of several nodes.
        timeout: how long [s]; None: for ever; zero or less: not at all.

    Returns:
        Those that have something, in the order given; empty after the time-out.
    """
    deadline = None if timeout is None else time.monotonic() + timeout
    polled = [(item.socket, zmq.POLLIN) for item in items]
    while True:
        ready = [item for item in items if item.ready()]
        if ready:
            return ready
        if deadline is None:
            milliseconds = -1
        else:
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                return []
            milliseconds = int(remaining * 1000) + 1
        zmq.zmq_poll(polled, milliseconds)
