"""One loop over many subscribers and servers."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, Protocol, TypeVar

import zmq


class Waitable(Protocol):
    """What ``wait`` waits for: a subscriber or a server."""

    @property
    def pollable(self) -> zmq.Socket[bytes] | int:
        """The socket or descriptor to poll."""
        ...

    def ready(self) -> bool:
        """Whether something waits."""
        ...

    def holding(self) -> bool:
        """Whether something waits outside the socket, where polling does not see it."""
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
    polled: list[tuple[Any, int]] = [(item.pollable, zmq.POLLIN) for item in items]
    while True:
        held = any(item.holding() for item in items)
        remaining = 0.0 if deadline is None else deadline - time.monotonic()
        if held or (deadline is not None and remaining <= 0.0):
            milliseconds = 0
        else:
            milliseconds = -1 if deadline is None else int(remaining * 1000.0) + 1
        polled_ready = dict(zmq.zmq_poll(polled, milliseconds))
        # A socket may have woken for news of publishers, or for a message that is refused: nothing for the caller.
        ready = [item for item in items if item.holding() or (item.pollable in polled_ready and item.ready())]
        if ready or (deadline is not None and remaining <= 0.0):
            return ready
