"""The pelvis' IMU at the far end of its serial port."""

from __future__ import annotations

from valor.common.instance import Instance, Settings
from valor.device_emulators.emulator import EmulatedFault
from valor.device_emulators.mip_sensor import MipSensor
from valor.device_emulators.serial_sensor import KINDS, SerialSensorEmulator
from valor.devices.mip import MicroStrainMip
from valor.robot.description import RobotDescription


class MicroStrainEmulator(SerialSensorEmulator):
    """One sensor."""

    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        table = robot.tables.devices[name]
        assert isinstance(table, MicroStrainMip)
        self._table = table
        super().__init__(name, instance, settings, KINDS - {EmulatedFault.OVER_TEMPERATURE})

    def _new_sensor(self) -> MipSensor:
        return MipSensor(self._table.model, self._table.serial, self._table.firmware)
