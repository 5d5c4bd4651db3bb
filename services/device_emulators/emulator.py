"""Base class of emulated devices, fault switches, and a line that injects faults into frames."""

from __future__ import annotations

import math
import random
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any

from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.device_emulators.robot import SimulatedRobot
from valor.devices.kinds import KINDS
from valor.robot.description import RobotDescription

LATENESS = 0.03  # delay of late responses [s]
SLOWNESS = 10  # one of so many frames of a slow unit is sent
LONGEST_REST = 0.01  # between steps of an emulator [s]


def make_emulator(name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> Emulator:
    """The emulator of a device. Raises ConfigurationError: its port cannot be opened."""
    emulator: Emulator = KINDS[robot.tables.devices[name].kind].load_emulator()(name, instance, settings, robot)
    return emulator


class EmulatedFault(StrEnum):
    """Faults of emulated units. Each emulator defines their effect on its protocol; none is ignored silently."""

    SILENT = "silent"  # it applies commands, and sends nothing
    SLOW = "slow"  # it responds at a tenth of its rate
    GARBAGE = "garbage"  # random bytes instead of its responses
    BAD_CHECKSUM = "bad_checksum"  # responses with a wrong checksum
    DUPLICATE = "duplicate"  # every response twice
    LATE = "late"  # every response 30 ms late
    ENCODER_JUMP = "encoder_jump"  # its first joint's encoder is off by 0.5 rad
    OVER_TEMPERATURE = "over_temperature"  # it reports 90 °C
    UNDER_VOLTAGE = "under_voltage"  # it reports 40 V of 48 V
    UNPLUGGED = "unplugged"  # no power: no responses, limp, and disabled afterwards


ALL_FAULTS = frozenset(EmulatedFault)


class NoSuchFaultError(ValorError):
    """A fault cannot be injected: no such unit, or none of that kind there."""


class FaultSwitches:
    """Active faults of units."""

    def __init__(self, kinds: Mapping[str, frozenset[EmulatedFault]]) -> None:
        """``kinds``: unit, as in ``DeviceStatus.units`` after the slash → faults that it can have."""
        self._kinds = kinds
        self._until: dict[tuple[str, EmulatedFault], float] = {}

    def __bool__(self) -> bool:
        """Return whether a fault was injected, active or over, since all were cleared."""
        return bool(self._until)

    def inject(self, unit: str, fault: EmulatedFault, until: float = math.inf) -> None:
        """Inject a fault until a time [s of the emulators' clock]; a past time ends it.

        Raises NoSuchFaultError: unknown unit, or a fault that it cannot have.
        """
        if unit not in self._kinds:
            raise NoSuchFaultError(f"unit {unit!r}: expected one of {', '.join(self._kinds)}")
        if fault not in self._kinds[unit]:
            raise NoSuchFaultError(f"fault {fault} of {unit}: expected one of {', '.join(sorted(self._kinds[unit]))}")
        self._until[unit, fault] = until

    def clear(self) -> None:
        self._until.clear()

    def active(self, unit: str, fault: EmulatedFault, now: float) -> bool:
        return bool(self._until) and self._until.get((unit, fault), -math.inf) > now


class FaultyLine:
    """Sends data of units, modified by the active faults of each unit."""

    def __init__(self, send: Callable[..., object], faults: FaultSwitches) -> None:
        """``send``: receives data, after the address if there is one."""
        self._send, self._faults = send, faults
        self._random = random.Random(0)
        self._late: deque[tuple[float, tuple[Any, ...]]] = deque()
        self._slow = Counter[str]()

    def send(self, unit: str, data: bytes, now: float, *address: int) -> None:
        """Send data of a unit at ``now`` [s]."""
        if not self._faults:
            self._send(*address, data)
            return

        def active(fault: EmulatedFault) -> bool:
            return self._faults.active(unit, fault, now)

        if active(EmulatedFault.SILENT):
            return
        if active(EmulatedFault.SLOW):
            self._slow[unit] += 1
            if self._slow[unit] % SLOWNESS:
                return
        if active(EmulatedFault.GARBAGE):
            data = self._random.randbytes(len(data))
        elif active(EmulatedFault.BAD_CHECKSUM):
            data = data[:-1] + bytes((data[-1] ^ 0x5A,))
        for _ in range(2 if active(EmulatedFault.DUPLICATE) else 1):
            if active(EmulatedFault.LATE):
                self._late.append((now + LATENESS, (*address, data)))
            else:
                self._send(*address, data)

    def flush(self, now: float) -> None:
        """Send delayed data that are due at ``now`` [s]."""
        while self._late and self._late[0][0] <= now:
            self._send(*self._late.popleft()[1])


class Emulator(ABC):
    """Device side of a port."""

    def __init__(self, name: str, kinds: Mapping[str, frozenset[EmulatedFault]]) -> None:
        """``kinds``: unit → faults that it can have."""
        self.name = name  # of the device, as in robot.yaml
        self.faults = FaultSwitches(kinds)  # of its units
        self.due = 0.0  # of the next step without received data [s]

    @abstractmethod
    def files(self) -> tuple[int, ...]:
        """Descriptors that are readable when the port has received data."""

    @abstractmethod
    def step(self, now: float, robot: SimulatedRobot) -> None:
        """Process received data without waiting, and respond with the simulated measurements.

        Called when one of ``files`` is readable and when it is ``due``; ``now``: of the emulators' clock [s].
        """

    @abstractmethod
    def close(self) -> None:
        """Close the port."""
