"""Waiting for, and polling of, many subscribers, servers and clients in one loop."""

import select
import time
from collections.abc import Sequence
from typing import Generic, Protocol, TypeVar

import zmq


class Waitable(Protocol):
    """A subscriber, a server, or a client with an open request, for ``wait``."""

    @property
    def pollable(self) -> zmq.Socket[bytes] | int | None:
        """The socket or descriptor to poll; None: none at present."""
        ...

    def ready(self) -> bool:
        """Return whether a message waits."""
        ...

    def patience(self) -> float | None:
        """Maximum time until the next check of ``ready``, also without messages [s]; None: no limit."""
        return None


class Pollable(Protocol):
    """A subscriber or server, for ``Poller``."""

    def fileno(self) -> int:
        """Descriptor that is readable when a message may have arrived."""
        ...

    @property
    def left(self) -> bool:
        """True if messages may remain after the last call."""
        ...


W = TypeVar("W", bound=Waitable)
L = TypeVar("L", bound=Pollable)


def wait(items: Sequence[W], timeout: float | None = None) -> list[W]:
    """Wait until one of several subscribers, servers and clients has a message.

    Args:
        items: subscribers, servers and clients, of one or of several nodes.
        timeout: [s]; None: no limit; zero or less: do not wait.

    Returns:
        The items with messages, in the given order; empty after the timeout.

    Raises:
        ValueError: no item can be polled, and there is no timeout.
    """
    deadline = None if timeout is None else time.monotonic() + timeout
    while True:
        # Nearly all items have no time limit and a constant socket; a client's socket changes.
        pollables = [item.pollable for item in items]
        patience = [item.patience() for item in items]
        remaining = None if deadline is None else max(0.0, deadline - time.monotonic())
        shortest = min((limit for limit in (*patience, remaining) if limit is not None), default=None)
        milliseconds = -1 if shortest is None else 0 if shortest <= 0.0 else int(shortest * 1000.0) + 1
        polled = [(pollable, zmq.POLLIN) for pollable in pollables if pollable is not None]
        if not polled and milliseconds:
            if milliseconds < 0:
                raise ValueError("wait: nothing to wait for, and no timeout")
            time.sleep(milliseconds / 1000.0)
        woken = dict(zmq.zmq_poll(polled, milliseconds))
        # A socket may have woken for a change of publishers, or for a message that is rejected.
        ready = [
            item
            for item, pollable, limit in zip(items, pollables, patience, strict=True)
            if (pollable in woken or limit is not None) and item.ready()
        ]
        if ready or (remaining is not None and remaining <= 0.0):
            return ready


class Poller(Generic[L]):
    """Reports which of many items may have messages, by one system call for any number of items.

    For control loops: a tenth of the cost of polling each. Each event is reported once, so the items returned must be
    processed (``drain``, ``latest``, ``serve``). Items with remaining messages (``left``) are reported again.
    """

    def __init__(self, items: Sequence[L]) -> None:
        """Poll items, which must remain open meanwhile."""
        self._items = {item.fileno(): item for item in items}
        self._epoll = select.epoll()
        for descriptor in self._items:
            self._epoll.register(descriptor, select.EPOLLIN)
        self._poll = self._epoll.poll
        self._most = max(1, len(items))
        self._all: list[L] | None = list(items)  # their events may have been consumed before

    def look(self, timeout: float = 0.0) -> list[L]:
        """Items that may have messages, after at most ``timeout`` [s] without one; all, on the first call."""
        if self._all is not None:
            everything, self._all = self._all, None
            return everything
        left = [item for item in self._items.values() if item.left]
        events = self._poll(0.0 if left else timeout, self._most)
        if not left:
            return [self._items[descriptor] for descriptor, _ in events] if events else []
        return list(dict.fromkeys((*left, *(self._items[descriptor] for descriptor, _ in events))))

    def close(self) -> None:
        """Stop polling; the items remain open."""
        self._epoll.close()
