"""A thread that takes in what comes for one subscriber, so that of a full queue the oldest is dropped."""

from __future__ import annotations

import os
import select
import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")
_LOOK = 1000  # it looks whether it is closed at least this often [ms]


class Reservoir(Generic[T]):
    """Messages that a thread takes in at once and holds up to a depth; of more, the oldest are dropped."""

    def __init__(self, take: Callable[[int], T | None], done: Callable[[], None], depth: int, name: str) -> None:
        """Begin.

        Args:
            take: waits so long [ms] for the next message.
            done: closes what it is taken from; called by the thread, as its last.
            depth: how many messages are held.
            name: of the thread.
        """
        self.evicted = 0
        self._take, self._done = take, done
        self._depth = depth
        self._held: deque[T] = deque()
        self._lock = threading.Lock()
        self._filled = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)  # readable while anything is held, or nudged
        self._nudged = False
        self._poll = select.poll()
        self._poll.register(self._filled, select.POLLIN)
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def several(self) -> bool:
        """Never asked to look for the newest."""
        return False

    @property
    def pollable(self) -> int:
        """For polling."""
        return self._filled

    def within(self, milliseconds: int) -> T | None:
        """The oldest message held; waits for one, for ever if negative."""
        checked = self.now()
        if checked is None and self._poll.poll(milliseconds):
            checked = self.now()
        return checked

    def now(self) -> T | None:
        """The oldest message held, if any."""
        with self._lock:
            checked = self._held.popleft() if self._held else None
            if not self._held and (checked is not None or self._nudged):
                self._nudged = False
                os.eventfd_read(self._filled)
            return checked

    def wake(self) -> None:
        """Make ``within`` return, if it waits. From any thread."""
        with self._lock:
            if not (self._closing or self._nudged):
                self._nudged = True
                os.eventfd_write(self._filled, 1)

    def close(self) -> None:
        """End the thread and close the socket. It must be woken by whoever calls."""
        with self._lock:
            self._closing = True
        self._thread.join()
        os.close(self._filled)

    def _run(self) -> None:
        while not self._closing:
            checked = self._take(_LOOK)
            if checked is None:
                continue
            with self._lock:
                if len(self._held) >= self._depth:
                    self._held.popleft()
                    self.evicted += 1
                elif not self._held:
                    os.eventfd_write(self._filled, 1)
                self._held.append(checked)
        self._done()
