"""The pelvis' IMU at the far end of its serial port."""

from __future__ import annotations

from valor.common.instance import Instance, Settings
from valor.device_emulators.emulator import EmulatedFault, Emulator, FaultSwitches
from valor.device_emulators.mip_sensor import Attitude, MipSensor
from valor.device_emulators.robot import SimulatedRobot
from valor.device_emulators.serial_port import FaultyLine, SerialPort
from valor.devices.ports import serial_port
from valor.devices.table import MicroStrainMip
from valor.robot.description import RobotDescription

_KINDS = frozenset(EmulatedFault) - {
    EmulatedFault.ENCODER_JUMP, EmulatedFault.OVER_TEMPERATURE, EmulatedFault.UNDER_VOLTAGE,
}  # fmt: skip


class MicroStrainEmulator(Emulator):
    """One sensor; unplugged, its port is gone, and it forgets what it was told."""

    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        table = robot.tables.devices[name]
        assert isinstance(table, MicroStrainMip)
        super().__init__(name, FaultSwitches((name,), _KINDS))
        self._table = table
        self._port = SerialPort(serial_port(instance, settings, name))
        self._line = FaultyLine(self._port, self.faults)
        self._sensor = self._new_sensor()

    def _new_sensor(self) -> MipSensor:
        return MipSensor(self._table.model, self._table.serial, self._table.firmware)

    def files(self) -> tuple[int, ...]:
        """The port."""
        return (self._port.fileno(),)

    def close(self) -> None:
        """Give the port back."""
        self._port.close()

    def step(self, now: float, robot: SimulatedRobot) -> None:
        """Answer commands, and stream what is due."""
        if self.faults.active(self.name, EmulatedFault.UNPLUGGED, now):
            self._port.unplug()
            return
        if not self._port.plugged:
            self._sensor = self._new_sensor()
            self._port.plug()
        for reply in self._sensor.receive(self._port.read()):
            self._line.send(self.name, reply, now)
        if self._sensor.is_due(now):
            measured = robot.measured
            self._sensor.attitude = Attitude.of_pelvis(
                measured.imu_orientation, measured.imu_angular_velocity, measured.imu_linear_acceleration
            )
            for packet in self._sensor.stream(now):
                self._line.send(self.name, packet, now)
        self._line.flush(now)
