"""LCM: UDP multicast that does not leave the computer; bytes."""

from __future__ import annotations

import time
from collections.abc import Callable

import lcm

from benchmarks.interprocess.payloads import SIZES
from benchmarks.interprocess.transports import STAMP, Place


def _lcm(place: Place, payload: str) -> lcm.LCM:
    return lcm.LCM(f"udpm://239.255.76.67:{20000 + 4 * place.number + list(SIZES).index(payload)}?ttl=0")


class Sender:
    """Publishes on one channel."""

    def __init__(self, place: Place, payload: str) -> None:
        self._lcm = _lcm(place, payload)
        self._filler = bytes(SIZES[payload] - STAMP.size)

    def send(self) -> None:
        """See the package."""
        self._lcm.publish("benchmark", STAMP.pack(time.monotonic_ns()) + self._filler)

    def close(self) -> None:
        """Nothing to do."""


class Receiver:
    """Subscribes to one channel."""

    def __init__(self, place: Place, payload: str) -> None:
        self._lcm = _lcm(place, payload)

    def run(self, take: Callable[[int], None], stop: Callable[[], bool]) -> None:
        """See the package."""
        subscription = self._lcm.subscribe("benchmark", lambda _, data: take(STAMP.unpack_from(data)[0]))
        subscription.set_queue_capacity(1000)
        while not stop():
            self._lcm.handle_timeout(100)

    def close(self) -> None:
        """Nothing to do."""
