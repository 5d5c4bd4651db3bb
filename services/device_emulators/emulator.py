"""What every emulator has in common: the far end of a device's port, and switches that make it fail."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from enum import StrEnum

from valor.common.errors import ValorError
from valor.device_emulators.robot import SimulatedRobot


class EmulatedFault(StrEnum):
    """How a unit can fail. What each means for a protocol is the emulator's to say; none may be ignored silently."""

    SILENT = "silent"  # it obeys, and says nothing
    SLOW = "slow"  # it answers at a tenth of its rate
    GARBAGE = "garbage"  # random bytes instead of its answers
    BAD_CHECKSUM = "bad_checksum"  # its answers, with a wrong checksum
    DUPLICATE = "duplicate"  # every answer twice
    LATE = "late"  # every answer 30 ms late
    ENCODER_JUMP = "encoder_jump"  # its first joint's encoder is off by 0.5 rad
    OVER_TEMPERATURE = "over_temperature"  # it says that it is at 90 °C
    UNDER_VOLTAGE = "under_voltage"  # it says that it has 40 V of 48 V
    UNPLUGGED = "unplugged"  # no power: deaf, mute and limp, and disabled when it is back


class NoSuchFaultError(ValorError):
    """A fault cannot be injected: no such unit, or none of that kind there."""


class FaultSwitches:
    """Which faults act on which units.

    Attributes:
        units: names, as in ``DeviceStatus.units`` behind the slash.
        kinds: which faults this device's units can have.
    """

    def __init__(self, units: tuple[str, ...], kinds: frozenset[EmulatedFault] = frozenset(EmulatedFault)) -> None:
        self.units = units
        self.kinds = kinds
        self._until: dict[tuple[str, EmulatedFault], float] = {}

    def inject(self, unit: str, fault: EmulatedFault, until: float = math.inf) -> None:
        """Let a unit fail until a time [s of the emulators' clock]; a time that has passed ends it.

        Raises:
            NoSuchFaultError: no such unit, or it cannot fail so.
        """
        if unit not in self.units:
            raise NoSuchFaultError(f"unit {unit!r}: expected one of {', '.join(self.units)}")
        if fault not in self.kinds:
            raise NoSuchFaultError(f"fault {fault}: expected one of {', '.join(sorted(self.kinds))}")
        self._until[unit, fault] = until

    def clear(self) -> None:
        """End all faults."""
        self._until.clear()

    def active(self, unit: str, fault: EmulatedFault, now: float) -> bool:
        """Whether a fault acts on a unit."""
        return bool(self._until) and self._until.get((unit, fault), -math.inf) > now


class Emulator(ABC):
    """The far end of a device's port.

    Attributes:
        name: of the device, as in robot.yaml.
        faults: of its units.
    """

    def __init__(self, name: str, faults: FaultSwitches) -> None:
        self.name = name
        self.faults = faults

    @abstractmethod
    def files(self) -> tuple[int, ...]:
        """Descriptors that are readable when something came over the port."""

    @abstractmethod
    def step(self, now: float, robot: SimulatedRobot) -> None:
        """Read the port without waiting, obey, and answer from what the robot's sensors say.

        Called every few milliseconds and whenever one of ``files`` is readable.

        Args:
            now: of the emulators' clock [s].
            robot: in which the device sits.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the port."""
