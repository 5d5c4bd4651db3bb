"""Nothing is sent: what the pacing itself takes."""

from __future__ import annotations

import time
from collections.abc import Callable

from benchmarks.interprocess.transports import Place


class Sender:
    """Only stamps."""

    def __init__(self, place: Place, payload: str) -> None:
        pass

    def send(self) -> None:
        """See the package."""
        time.monotonic_ns()

    def close(self) -> None:
        """Nothing to do."""


class Receiver:
    """Waits in vain."""

    def __init__(self, place: Place, payload: str) -> None:
        pass

    def run(self, take: Callable[[int], None], stop: Callable[[], bool]) -> None:
        """See the package."""
        while not stop():
            time.sleep(0.1)

    def close(self) -> None:
        """Nothing to do."""
