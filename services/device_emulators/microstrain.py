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

        def new() -> MipSensor:
            return MipSensor(table.model, table.serial, table.firmware)

        super().__init__(name, instance, settings, new, KINDS - {EmulatedFault.OVER_TEMPERATURE})
