"""Force/torque sensors in feet and wrists."""

from __future__ import annotations

from valor.common.arrays import FloatArray
from valor.common.instance import Instance, Settings
from valor.device_emulators.can_emulator import CanEmulator
from valor.device_emulators.emulator import EmulatedFault
from valor.device_emulators.robot import SimulatedRobot
from valor.devices import can_frames
from valor.devices.can_frames import Status
from valor.devices.end_to_end import protect
from valor.devices.table import FtCan
from valor.robot.description import RobotDescription

FEVER, NORMAL = 90.0, 31.0  # [°C]

_KINDS = frozenset(EmulatedFault) - {EmulatedFault.ENCODER_JUMP, EmulatedFault.UNDER_VOLTAGE}


class ForceTorqueEmulator(CanEmulator):
    """The sensors on one CAN bus."""

    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        table = robot.tables.devices[name]
        assert isinstance(table, FtCan)
        super().__init__(name, settings, table.bus, table.sensors, _KINDS)
        self._places = {unit.id: f"{unit.at}_wrench" for unit in table.sensors}

    def _state(self, unit: int, counter: int, now: float, robot: SimulatedRobot) -> bytes:
        wrench: FloatArray = getattr(robot.measured, self._places[unit])
        hot = self.faults.active(self._names[unit], EmulatedFault.OVER_TEMPERATURE, now)
        status = Status.OVER_TEMPERATURE if hot else Status(0)
        content = can_frames.SENSOR_STATE.pack(counter, status, round(10.0 * (FEVER if hot else NORMAL)), *wrench)
        return protect(can_frames.STATE + unit, content)

    def _power_changed(self, unit: int, on: bool, robot: SimulatedRobot) -> None:
        """It forgets nothing that matters."""
