"""A CAN bus as its devices see it: frames out, frames of their kinds in, and opened anew when it fails."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator

import can

from valor.common.errors import ConfigurationError
from valor.devices import can_frames

REOPEN_EVERY = 0.5  # a bus that fails is opened anew [s]
_STRANGE = 64  # frames in a row that are none, after which it is the bus that fails

Received = tuple[int, int, can.Message]
"""Kind and unit of a frame, by its identifier, and the frame."""


class CanPort:
    """An open bus.

    All methods but ``reopen`` and ``close`` raise ``can.CanError`` or ``OSError`` when the bus itself fails.
    """

    def __init__(self, open_bus: Callable[[], can.BusABC]) -> None:
        """``open_bus``: as often as needed; raises ``ConfigurationError``."""
        self._open_bus = open_bus
        self._bus = open_bus()
        self._reopened = 0.0

    def fileno(self) -> int:
        """Readable when something has come."""
        return int(self._bus.fileno())

    def send(self, message: can.Message) -> None:
        """Send a frame."""
        self._bus.send(message)

    def receive(self, timeout: float) -> Iterator[Received]:
        """What is on the bus, from units to their master; waits for the first frame [s]."""
        strange = 0
        while True:
            try:
                message = self._bus.recv(timeout)
            except can.CanOperationError:  # no CAN frame: on multicast anybody may speak
                strange += 1
                if strange > _STRANGE:
                    raise
                continue
            if message is None:
                return
            timeout = 0.0
            kind = message.arbitration_id & can_frames.KIND
            if kind in can_frames.TO_MASTER:
                yield kind, message.arbitration_id & can_frames.UNIT, message

    def reopen(self) -> None:
        """Open the bus anew, as an adapter that was plugged in again needs it; the old one is kept until that is done.

        The units on it had their power from elsewhere: those that lost it say so.
        """
        now = time.monotonic()
        if now - self._reopened < REOPEN_EVERY:
            return
        self._reopened = now
        with contextlib.suppress(ConfigurationError):  # not yet
            bus = self._open_bus()
            with contextlib.suppress(can.CanError, OSError):
                self._bus.shutdown()
            self._bus = bus

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()
