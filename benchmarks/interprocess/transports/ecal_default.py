"""eCAL as it is installed: shared memory within one computer, a callback; bytes."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import ecal.nanobind_core as ecal

from benchmarks.interprocess.payloads import SIZES
from benchmarks.interprocess.transports import STAMP, Place


def _topic(place: Place, payload: str) -> str:
    if not ecal.is_initialized():
        ecal.initialize("benchmark")
    return f"{place.folder.name} {payload}"


class Sender:
    """A publisher."""

    def __init__(self, place: Place, payload: str) -> None:
        self._publisher: Any = ecal.Publisher(_topic(place, payload))
        self._filler = bytes(SIZES[payload] - STAMP.size)

    def send(self) -> None:
        """See the package."""
        self._publisher.send(STAMP.pack(time.monotonic_ns()) + self._filler)

    def close(self) -> None:
        """Withdraw it."""
        self._publisher = None


class Receiver:
    """A subscriber."""

    def __init__(self, place: Place, payload: str) -> None:
        self._subscriber: Any = ecal.Subscriber(_topic(place, payload))

    def run(self, take: Callable[[int], None], stop: Callable[[], bool]) -> None:
        """See the package."""

        def received(_publisher: Any, _type: Any, data: Any) -> None:
            take(STAMP.unpack_from(data.buffer)[0])

        self._subscriber.set_receive_callback(received)
        while not stop():
            time.sleep(0.1)

    def close(self) -> None:
        """Withdraw it."""
        self._subscriber.remove_receive_callback()
        self._subscriber = None
