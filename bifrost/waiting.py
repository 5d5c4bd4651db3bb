"""One loop over many subscribers, servers and clients: waiting for them, or looking at all of them at once."""

from __future__ import annotations

import select
import time
from collections.abc import Sequence
from typing import Generic, Protocol, TypeVar

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
        return False

    def patience(self) -> float | None:
        """How long one may wait before looking again even if nothing comes [s]; None: for ever."""
        return None


class Lookable(Protocol):
    """What a ``Poller`` looks at: a subscriber or a server."""

    def fileno(self) -> int:
        """Readable when something may have come that has not been looked at."""
        ...

    @property
    def left(self) -> bool:
        """Whether the last look may have left something."""
        ...


W = TypeVar("W", bound=Waitable)
L = TypeVar("L", bound=Lookable)


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


class Poller(Generic[L]):
    """Tells which of many may have something, by one system call however many there are.

    For a control loop: to find that nothing has come costs as much for ten subscribers as for one, and a tenth of
    what asking each of them does; to wait for all of them costs no more. What is told must be looked at (``drain``,
    ``latest``, ``serve``), for it is told once; what that has left, by a bound of its own, is told again.
    """

    def __init__(self, items: Sequence[L]) -> None:
        """Look at these, each of which must stay open as long as it is looked at."""
        self._items = {item.fileno(): item for item in items}
        self._epoll = select.epoll()
        for descriptor in self._items:
            self._epoll.register(descriptor, select.EPOLLIN)
        self._poll = self._epoll.poll
        self._most = max(1, len(items))
        self._all: list[L] | None = list(items)  # they may have something that their descriptors have told before

    def look(self, timeout: float = 0.0) -> list[L]:
        """Those that may have something; the first time, all.

        Args:
            timeout: how long to wait for the first of them [s]; zero: not at all.
        """
        if self._all is not None:
            everything, self._all = self._all, None
            return everything
        left = [item for item in self._items.values() if item.left]
        events = self._poll(0.0 if left else timeout, self._most)
        if not left:
            return [self._items[descriptor] for descriptor, _ in events] if events else []
        return list(dict.fromkeys((*left, *(self._items[descriptor] for descriptor, _ in events))))

    def close(self) -> None:
        """Look no more; closes nothing else."""
        self._epoll.close()


def _has_something(item: Waitable, woken: bool) -> bool:
    return item.holding() or ((woken or item.patience() is not None) and item.ready())
