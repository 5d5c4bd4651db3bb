"""Bifrost as the robot uses it: typed messages, decoded into NumPy, the latest value."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

import bifrost
from benchmarks.interprocess.payloads import SIZES, Block, Number, Proprioceptor, proprioceptor
from benchmarks.interprocess.transports import Place

_TYPES: dict[str, type[bifrost.Message]] = {"8 B": Number, "Proprioceptor": Proprioceptor}


def topic(place: Place, payload: str) -> str:
    """One for each pair of ends and payload."""
    return f"benchmark/{place.folder.name}/{payload.replace(' ', '_')}"


class Sender:
    """A node with one publisher."""

    def __init__(self, place: Place, payload: str) -> None:
        self._node = bifrost.Node("sender")
        self._publisher: Any = self._node.publisher(topic(place, payload), _TYPES.get(payload, Block))
        number, block, state = Number(0.0), Block(np.zeros(SIZES[payload], np.uint8)), proprioceptor()
        stamp = block.data[:8].view(np.int64)
        now, publish = time.monotonic_ns, self._publisher.publish

        def send_number() -> None:
            number.value = float(now())
            publish(number)

        def send_state() -> None:
            state.time = now()
            publish(state)

        def send_block() -> None:
            stamp[0] = now()
            publish(block)

        self.send = {"8 B": send_number, "Proprioceptor": send_state}.get(payload, send_block)

    def close(self) -> None:
        """Leave."""
        self._node.close()


class Receiver:
    """A node with one subscriber."""

    QUEUE: int | None = None

    def __init__(self, place: Place, payload: str) -> None:
        self._node = bifrost.Node("receiver")
        self._payload = payload
        self._subscriber: Any = self._node.subscriber(
            topic(place, payload), _TYPES.get(payload, Block), queue=self.QUEUE
        )

    def run(self, take: Callable[[int], None], stop: Callable[[], bool]) -> None:
        """See the package."""
        receive = self._subscriber.receive
        while not stop():
            received = receive(0.1)
            if received is None:
                continue
            if self._payload == "8 B":
                take(int(received.message.value))
            elif self._payload == "Proprioceptor":
                take(received.message.time)
            else:
                take(int(received.message.data[:8].view(np.int64)[0]))

    def close(self) -> None:
        """Leave."""
        self._node.close()
