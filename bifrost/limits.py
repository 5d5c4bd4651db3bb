"""How much of one sender is listened to: one that sends more, and goes on, is muted while it does."""

from __future__ import annotations

import os
import socket as sockets
import time
from collections.abc import Collection, KeysView

import msgspec
import zmq

MUTE = 1.0  # what is muted is heard again after so long, and muted again if it has gone on [s]
LOOKS = 64  # messages of which nothing is delivered that one look takes in, at most


class Limit(msgspec.Struct, frozen=True):
    """What is no flood yet.

    Attributes:
        rate: messages a second, by the sender's stamps, that may go on for ever.
        burst: so many more than that are let through.
    """

    rate: float
    burst: int


class Meter:
    """Whether one sender is within a limit (the generic cell rate algorithm, ITU-T I.371)."""

    __slots__ = ("_due", "_interval", "_patience")

    def __init__(self, limit: Limit) -> None:
        self._interval = int(1e9 / limit.rate)
        self._patience = self._interval * limit.burst
        self._due = -(2**63)

    def exceeds(self, count: int, at: int) -> bool:
        """Count messages up to a time [ns]; whether that was too much. It then begins anew."""
        due = self._due + count * self._interval
        if due - at > self._patience:
            self._due = at
            return True
        self._due = max(due, at)
        return False


class Muted:
    """The publishers that one subscriber does not listen to for now.

    Attributes:
        ends: when the next of them is heard again, monotonic [s]; infinite if there is none.
    """

    def __init__(self) -> None:
        self._until: dict[str, float] = {}  # by endpoint
        self.ends = float("inf")

    def add(self, endpoint: str) -> None:
        """Mute one."""
        self._until[endpoint] = time.monotonic() + MUTE
        self.ends = min(self._until.values())

    def endpoints(self) -> KeysView[str]:
        """All that are muted still."""
        if time.monotonic() >= self.ends:
            now = time.monotonic()
            self._until = {endpoint: until for endpoint, until in self._until.items() if until > now}
            self.ends = min(self._until.values(), default=float("inf"))
        return self._until.keys()


def endpoint_of(frame: zmq.Frame, among: Collection[str]) -> str:
    """The endpoint that a frame has come from, by its connection and not by what it says; empty if not known."""
    try:
        with sockets.socket(fileno=os.dup(int(frame.get(zmq.SRCFD)))) as connection:
            host, port = connection.getpeername()[:2]
    except (OSError, ValueError, zmq.ZMQError):  # from within the process; or the connection has ended
        return ""
    return next((each for each in among if each in (f"tcp://{host}:{port}", f"tcp://[{host}]:{port}")), "")
