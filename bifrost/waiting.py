"""One loop over many subscribers, servers and clients."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Protocol, TypeVar

import zmq


class Waitable(Protocol):
    """What ``wait`` waits for: a subscriber, a server, or a client that has asked."""

    @property
    def pollable(self) -> zmq.Socket[bytes] | int | None:
        """The socket or descriptor to poll; None: there is none now."""
        ...

    def ready(self) -> bool:
        """Whether something waits."""
        ...

    def holding(self) -> bool:
        """Whether something waits outside the socket, where polling does not see it."""
        ...

    def patience(self) -> float | None:
        """How long one may wait before looking again even if nothing comes [s]; None: for ever."""
        ...


W = TypeVar("W", bound=Waitable)


def wait(items: Sequence[W], timeout: float | None = None) -> list[W]:
    """Wait until one of several subscribers, servers and clients has something.

    Args:
        items: subscribers, servers and clients, of one or of several nodes.
        timeout: how long [s]; None: for ever; zero or less: not at all.

    Returns:
        Those that have something, in the order given; empty after the time-out.

    Raises:
        ValueError: nothing could ever end the wait.
    """
    deadline = None if timeout is None else time.monotonic() + timeout
    while True:
        # Nearly all are never impatient and always poll the same; a client's socket comes and goes.
        pollables = [item.pollable for item in items]
        remaining = None if deadline is None else max(0.0, deadline - time.monotonic())
        shortest, patient = remaining, True
        for item in items:
            patience = item.patience()
            if patience is not None:
                patient = False
                shortest = patience if shortest is None else min(shortest, patience)
            if item.holding():
                patient, shortest = False, 0.0
        milliseconds = -1 if shortest is None else 0 if shortest <= 0.0 else int(shortest * 1000.0) + 1
        polled = [(pollable, zmq.POLLIN) for pollable in pollables if pollable is not None]
        if not polled and milliseconds:
            if milliseconds < 0:
                raise ValueError("wait: nothing to wait for, and no time limit")
            time.sleep(milliseconds / 1000.0)
        woken = dict(zmq.zmq_poll(polled, milliseconds))
        # A socket may have woken for news of publishers, or for a message that is refused: nothing for the caller.
        ready = [
            item
            for item, pollable in zip(items, pollables, strict=True)
            if (pollable in woken or not patient) and _has_something(item, pollable in woken)
        ]
        if ready or (remaining is not None and remaining <= 0.0):
            return ready


def _has_something(item: Waitable, woken: bool) -> bool:
    return item.holding() or ((woken or item.patience() is not None) and item.ready())
