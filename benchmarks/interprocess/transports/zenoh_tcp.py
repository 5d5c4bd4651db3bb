"""Zenoh: two peers over TCP, without batching ("express"), a callback; bytes."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

import zenoh

from benchmarks.interprocess.payloads import SIZES
from benchmarks.interprocess.transports import STAMP, Place


def _session(listen: list[str], connect: list[str]) -> Any:
    configuration = {
        "mode": "peer",
        "listen": {"endpoints": listen},
        "connect": {"endpoints": connect},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {"shared_memory": {"enabled": False}},
    }
    return zenoh.open(zenoh.Config.from_json5(json.dumps(configuration)))


def _endpoint(place: Place, payload: str) -> str:
    return f"tcp/127.0.0.1:{21000 + 4 * place.number + list(SIZES).index(payload)}"


class Sender:
    """A peer that listens and publishes."""

    def __init__(self, place: Place, payload: str) -> None:
        self._session = _session([_endpoint(place, payload)], [])
        self._publisher = self._session.declare_publisher("benchmark", express=True)
        self._filler = bytes(SIZES[payload] - STAMP.size)
        place.leave(f"{payload}.listens", "")

    def send(self) -> None:
        """See the package."""
        self._publisher.put(STAMP.pack(time.monotonic_ns()) + self._filler)

    def close(self) -> None:
        """Leave."""
        self._session.close()


class Receiver:
    """A peer that connects and subscribes."""

    def __init__(self, place: Place, payload: str) -> None:
        place.find(f"{payload}.listens")
        self._session = _session([], [_endpoint(place, payload)])

    def run(self, take: Callable[[int], None], stop: Callable[[], bool]) -> None:
        """See the package."""

        def received(sample: Any) -> None:
            take(STAMP.unpack_from(sample.payload.to_bytes())[0])

        self._session.declare_subscriber("benchmark", received)
        while not stop():
            time.sleep(0.1)

    def close(self) -> None:
        """Leave."""
        self._session.close()
