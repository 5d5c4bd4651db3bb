"""What is asked of every unit, whatever it is: that it is the one of robot.yaml, not too warm, and has its voltage."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from valor.comms_manager.hardware.device import Ailment, DeviceError, Fault, UnitRecord


def require_identity(unit: str, said: Mapping[str, object], expected: Mapping[str, object]) -> None:
    """See that a unit says of itself what robot.yaml says of it: model, serial number, firmware.

    Raises:
        DeviceError: names the unit, what is different, and what was expected.
    """
    for what, value in expected.items():
        if said[what] != value:
            raise DeviceError(f"{unit}: {what} {said[what]!r}; expected {value!r} (robot.yaml)")


@dataclass(frozen=True, slots=True)
class Limits:
    """From which temperatures and voltages on a unit is not to be relied on, and how far it must come back."""

    warm: float  # [°C]
    hot: float  # [°C]
    low: float  # [V]
    flat: float = -math.inf  # [V]
    cooler: float = 3.0  # below a limit, it is warm no more [K]
    more: float = 1.0  # above a limit, the voltage is low no more [V]


class Condition:
    """How warm a unit is and how much voltage it has.

    Attributes:
        ailments: what is told of it; the same object while nothing changes.
    """

    def __init__(self, record: UnitRecord, limits: Limits) -> None:
        self._record, self._limits = record, limits
        self._warmth = self._weakness = 0  # how many of the limits are passed
        self.ailments: tuple[Ailment, ...] = ()

    def judge(self, temperature: float, voltage: float = math.nan) -> tuple[Ailment, ...]:
        """Write down what a unit says [°C, V]; returns ``ailments``. A voltage that is not known is none too low."""
        record, limits = self._record, self._limits
        record.temperature, record.voltage = temperature, voltage
        warmth = level(temperature, (limits.warm, limits.hot), self._warmth, limits.cooler)
        weakness = level(-voltage, (-limits.low, -limits.flat), self._weakness, limits.more)
        if warmth == self._warmth and weakness == self._weakness:
            return self.ailments
        self._warmth, self._weakness = warmth, weakness
        ailments = []
        if warmth:
            fault, limit = ((Fault.WARM, limits.warm), (Fault.HOT, limits.hot))[warmth - 1]
            ailments.append(Ailment(record.unit, fault, f"{temperature:.0f} °C; expected less than {limit:g} °C"))
        if weakness:
            fault, limit = ((Fault.LOW_VOLTAGE, limits.low), (Fault.FLAT, limits.flat))[weakness - 1]
            ailments.append(Ailment(record.unit, fault, f"{voltage:.1f} V; expected more than {limit:g} V"))
        self.ailments = tuple(ailments)
        return self.ailments


def level(value: float, limits: tuple[float, float], before: int, hysteresis: float) -> int:
    """How many of the ascending limits a value reaches; it must fall below one by the hysteresis to count less."""
    reached = 2 if value >= limits[1] else 1 if value >= limits[0] else 0
    if reached < before and value > limits[before - 1] - hysteresis:
        return before
    return reached
