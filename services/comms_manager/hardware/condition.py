"""Checks of every unit: identity, temperature, voltage, delay of its data."""

import math
from dataclasses import dataclass

from valor.comms_manager.hardware.device import DeviceError, Fault, UnitFault, UnitRecord


def require_identity(unit: str, table: object, **reported: object) -> None:
    """Compare the reported identity of a unit (model, serial, firmware) with its table in robot.yaml.

    Raises DeviceError: names the unit, the difference, and the expectation.
    """
    for key, value in reported.items():
        if value != (expected := getattr(table, key)):
            what = "serial number" if key == "serial" else key
            raise DeviceError(f"{unit}: {what} {value!r}; expected {expected!r} (robot.yaml)")


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of temperature and voltage, with hysteresis."""

    warm: float  # [°C]
    hot: float  # [°C]
    low: float  # [V]
    flat: float = -math.inf  # [V]
    cooler: float = 3.0  # hysteresis of temperature [K]
    more: float = 1.0  # hysteresis of voltage [V]


class Condition:
    """Temperature and voltage of a unit."""

    def __init__(self, record: UnitRecord, limits: Limits) -> None:
        self._record, self._limits = record, limits
        self._warmth = self._weakness = 0  # number of limits exceeded
        self.unit_faults: tuple[UnitFault, ...] = ()  # present faults; the same object without a change

    def judge(self, temperature: float, voltage: float = math.nan) -> tuple[UnitFault, ...]:
        """Store temperature and voltage [°C, V]; returns ``unit_faults``. An unknown voltage (NaN) is not too low."""
        record, limits = self._record, self._limits
        record.temperature, record.voltage = temperature, voltage
        warmth = level(temperature, (limits.warm, limits.hot), self._warmth, limits.cooler)
        weakness = level(-voltage, (-limits.low, -limits.flat), self._weakness, limits.more)
        if warmth == self._warmth and weakness == self._weakness:
            return self.unit_faults
        self._warmth, self._weakness = warmth, weakness
        unit_faults = []
        if warmth:
            fault, limit = ((Fault.WARM, limits.warm), (Fault.HOT, limits.hot))[warmth - 1]
            unit_faults.append(UnitFault(record.unit, fault, f"{temperature:.0f} °C; expected less than {limit:g} °C"))
        if weakness:
            fault, limit = ((Fault.LOW_VOLTAGE, limits.low), (Fault.FLAT, limits.flat))[weakness - 1]
            unit_faults.append(UnitFault(record.unit, fault, f"{voltage:.1f} V; expected more than {limit:g} V"))
        self.unit_faults = tuple(unit_faults)
        return self.unit_faults


def level(value: float, limits: tuple[float, float], before: int, hysteresis: float) -> int:
    """Number of ascending limits that a value reaches, with hysteresis when it falls."""
    reached = 2 if value >= limits[1] else 1 if value >= limits[0] else 0
    if reached < before and value > limits[before - 1] - hysteresis:
        return before
    return reached


DRIFT = 2e-4  # largest drift of a device's clock [s/s]


class DeviceClock:
    """Compares a device's time stamps with local time; the fastest transfer so far counts as no delay.

    Serial protocols have no sequence numbers: time stamps reveal repeated and delayed data.
    """

    def __init__(self) -> None:
        self._offset = math.inf  # local time less the device's, without delay [s]
        self._device = self._ours = -math.inf

    def lateness(self, device: float, ours: float) -> float | None:
        """Delay of data with the device's stamp ``device``, received at ``ours`` [s]; None if it is not newer."""
        if device <= self._device:
            return None
        if math.isfinite(self._ours):
            self._offset += DRIFT * (ours - self._ours)
        self._offset = min(self._offset, ours - device)
        self._device, self._ours = device, ours
        return ours - device - self._offset

    def reset(self) -> None:
        self.__init__()  # type: ignore[misc]
