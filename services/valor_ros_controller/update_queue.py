"""Work for the update thread that another thread waits for: what it sees and does lies between two cycles."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

T = TypeVar("T")

PATIENCE = 2.0
"""The update loop turns every few milliseconds, even when the robot is silent: after so long it is not running [s]."""


class UpdateQueue:
    """Calls from other threads, run in the update thread in their order."""

    def __init__(self) -> None:
        self._calls: deque[Callable[[], None]] = deque()

    def call(self, function: Callable[[], T]) -> T:
        """Have a function run between two cycles and return what it returns; from any thread but the update thread.

        Raises:
            TimeoutError: the update loop does not turn.
            Exception: what the function raised.
        """
        future: Future[T] = Future()

        def run() -> None:
            try:
                future.set_result(function())
            except Exception as error:
                future.set_exception(error)

        self._calls.append(run)
        try:
            return future.result(PATIENCE)
        except TimeoutError:
            if future.done():
                raise
            raise TimeoutError(f"the update loop did not turn within {PATIENCE:g} s") from None

    def run(self) -> None:
        """Run what waits. Update thread."""
        while self._calls:
            self._calls.popleft()()
