"""Work for the update thread that another thread waits for: what it sees and does lies between two cycles."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

PATIENCE = 2.0
"""The update loop turns every few milliseconds, even when the robot is silent: after so long it is not running [s]."""


class _Call(Generic[T]):
    def __init__(self, function: Callable[[], T]) -> None:
        self._function = function
        self._done = threading.Event()
        self._result: T | None = None
        self._error: Exception | None = None

    def run(self) -> None:
        try:
            self._result = self._function()
        except Exception as error:
            self._error = error
        self._done.set()

    def wait(self, timeout: float) -> T:
        if not self._done.wait(timeout):
            raise TimeoutError(f"the update loop did not turn within {timeout:g} s")
        if self._error is not None:
            raise self._error
        return self._result  # type: ignore[return-value]  # a T, once it is done


class UpdateQueue:
    """Calls from other threads, run in the update thread in their order."""

    def __init__(self) -> None:
        self._calls: deque[_Call[object]] = deque()

    def call(self, function: Callable[[], T]) -> T:
        """Have a function run between two cycles and return what it returns; from any thread but the update thread.

        Raises:
            TimeoutError: the update loop does not turn.
            Exception: what the function raised.
        """
        call = _Call(function)
        self._calls.append(call)  # type: ignore[arg-type]  # what it returns is read through ``call`` alone
        return call.wait(PATIENCE)

    def run(self) -> None:
        """Run what waits. Update thread."""
        while self._calls:
            self._calls.popleft().run()
