"""What goes wrong with frames on their way, on whatever line."""

from __future__ import annotations

import random
from collections import Counter, deque
from collections.abc import Callable
from typing import Generic, TypeVar

from valor.device_emulators.emulator import EmulatedFault, FaultSwitches

LATENESS = 0.03  # of late answers [s]
SLOWNESS = 10  # a slow unit's frames get through one in so many

F = TypeVar("F")


class FaultyLine(Generic[F]):
    """Sends frames as soundly or as badly as the faults of the unit that they come from will have it."""

    def __init__(
        self,
        send: Callable[[F], None],
        faults: FaultSwitches,
        data: Callable[[F], bytes],
        with_data: Callable[[F, bytes], F],
    ) -> None:
        """What stands behind it.

        Args:
            send: the line itself.
            faults: of the units.
            data: of a frame.
            with_data: the frame with other data in the place of its own.
        """
        self._send, self._faults, self._data, self._with_data = send, faults, data, with_data
        self._random = random.Random(0)
        self._late: deque[tuple[float, F]] = deque()
        self._slow = Counter[str]()

    def send(self, unit: str, frame: F, now: float) -> None:
        """Send a unit's frame at ``now`` [s]."""

        def active(fault: EmulatedFault) -> bool:
            return self._faults.active(unit, fault, now)

        if active(EmulatedFault.SILENT):
            return
        if active(EmulatedFault.SLOW):
            self._slow[unit] += 1
            if self._slow[unit] % SLOWNESS:
                return
        if active(EmulatedFault.GARBAGE):
            frame = self._with_data(frame, self._random.randbytes(len(self._data(frame))))
        elif active(EmulatedFault.BAD_CHECKSUM):
            data = self._data(frame)
            frame = self._with_data(frame, data[:-1] + bytes((data[-1] ^ 0x5A,)))
        for _ in range(2 if active(EmulatedFault.DUPLICATE) else 1):
            if active(EmulatedFault.LATE):
                self._late.append((now + LATENESS, frame))
            else:
                self._send(frame)

    def flush(self, now: float) -> None:
        """Send what is due at ``now`` [s]."""
        while self._late and self._late[0][0] <= now:
            self._send(self._late.popleft()[1])
