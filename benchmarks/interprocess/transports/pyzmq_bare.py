"""pyzmq alone, PUB and SUB over TCP: bytes, no types, no encryption."""

from __future__ import annotations

import time
from collections.abc import Callable

import zmq

from benchmarks.interprocess.payloads import SIZES
from benchmarks.interprocess.transports import STAMP, Place

Socket = zmq.Socket[bytes]


class Sender:
    """A PUB that binds."""

    def __init__(self, place: Place, payload: str) -> None:
        self._context: zmq.Context[Socket] = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        self.secure(place, payload, self._socket)
        self._socket.bind("tcp://127.0.0.1:*")
        place.leave(f"{payload}.endpoint", self._socket.getsockopt_string(zmq.LAST_ENDPOINT))
        self._buffer = bytearray(SIZES[payload])

    def secure(self, place: Place, payload: str, socket: Socket) -> None:
        """Nothing here."""

    def send(self) -> None:
        """See the package."""
        STAMP.pack_into(self._buffer, 0, time.monotonic_ns())
        self._socket.send(self._buffer)

    def close(self) -> None:
        """Close."""
        self._context.destroy(linger=0)


class Receiver:
    """A SUB that connects."""

    def __init__(self, place: Place, payload: str) -> None:
        self._context: zmq.Context[Socket] = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        endpoint = place.find(f"{payload}.endpoint")
        self.secure(place, payload, self._socket)
        self._socket.setsockopt(zmq.SUBSCRIBE, b"")
        self._socket.setsockopt(zmq.RCVTIMEO, 100)
        self._socket.connect(endpoint)

    def secure(self, place: Place, payload: str, socket: Socket) -> None:
        """Nothing here."""

    def run(self, take: Callable[[int], None], stop: Callable[[], bool]) -> None:
        """See the package."""
        receive, unpack = self._socket.recv, STAMP.unpack_from
        while not stop():
            try:
                take(unpack(receive())[0])
            except zmq.Again:
                continue

    def close(self) -> None:
        """Close."""
        self._context.destroy(linger=0)
