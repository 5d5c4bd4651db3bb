"""Force/torque sensors in feet and wrists, on CAN."""

from __future__ import annotations

import math
import time

import numpy as np

from valor.comms_manager.hardware.can_device import CanDevice, CanUnit
from valor.comms_manager.hardware.device import DeviceContext, IntVector, WrenchMeasurement
from valor.devices import can_frames
from valor.devices.can_frames import Identity
from valor.devices.table import FtCan

MOST = 20_000.0  # force [N] and torque [N·m]: more is nonsense


class ForceTorque(CanDevice):
    """The sensors on one bus."""

    def __init__(self, name: str, context: DeviceContext) -> None:
        table = context.robot.tables.devices[name]
        assert isinstance(table, FtCan)
        supply = context.robot.tables.supply
        units = {
            each.id: CanUnit(each.id, Identity(each.serial, each.firmware), name, supply) for each in table.sensors
        }
        super().__init__(name, context, table.bus, units, can_frames.SENSOR_STATE_LENGTH)
        self._row = {number: row for row, number in enumerate(units)}
        self._stamp: IntVector = np.zeros(len(units), dtype=np.int64)
        self._wrench = np.zeros((len(units), 6))

    def _take(self, unit: CanUnit, data: bytes | bytearray) -> bool:
        _, _, temperature, *wrench = can_frames.SENSOR_STATE.unpack_from(data)
        size = max(map(abs, wrench))
        if not (math.isfinite(sum(wrench)) and size < MOST):
            return False
        row = self._row[unit.number]
        self._wrench[row] = wrench
        self._stamp[row] = time.monotonic_ns()
        self._judge(unit, 0.1 * temperature, math.nan, ())
        return True

    def _hand_over(self) -> None:
        self.wrench = WrenchMeasurement(self._stamp.copy(), self._wrench.copy())
