"""A sensor at the far end of its serial port, whatever it says on it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from valor.common.instance import Instance, Settings
from valor.common.messages import Proprioceptor
from valor.device_emulators.emulator import EmulatedFault, Emulator, FaultSwitches
from valor.device_emulators.robot import SimulatedRobot
from valor.device_emulators.serial_port import SerialPort, line
from valor.devices.ports import serial_port

KINDS = frozenset(EmulatedFault) - {EmulatedFault.ENCODER_JUMP, EmulatedFault.UNDER_VOLTAGE}
"""Of faults that a sensor can have that says how warm it is."""


class Sensor(Protocol):
    """What a sensor makes of the bytes that it is sent, and the messages that it streams."""

    def receive(self, data: bytes) -> list[bytes]:
        """Take bytes of the driver; returns the answers."""

    def is_due(self, now: float) -> bool:
        """Whether ``stream`` would give anything at ``now`` [s]."""

    def feel(self, measured: Proprioceptor, hot: bool) -> None:
        """What the robot's sensors say is what it feels; and whether it is too hot."""

    def stream(self, now: float) -> list[bytes]:
        """The messages that are due at ``now`` [s]."""


class SerialSensorEmulator(Emulator):
    """One sensor; unplugged, its port is gone, and it forgets what it was told."""

    def __init__(
        self,
        name: str,
        instance: Instance,
        settings: Settings,
        new: Callable[[], Sensor],
        kinds: frozenset[EmulatedFault] = KINDS,
    ) -> None:
        """``new``: makes a sensor that was just switched on; ``kinds``: of faults that it can have."""
        super().__init__(name, FaultSwitches((name,), kinds))
        self._port = SerialPort(serial_port(instance, settings, name))
        self._line = line(self._port, self.faults)
        self._new, self._sensor = new, new()

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
            self._sensor = self._new()
            self._port.plug()
        for reply in self._sensor.receive(self._port.read()):
            self._line.send(self.name, reply, now)
        if self._sensor.is_due(now):
            hot = self.faults.active(self.name, EmulatedFault.OVER_TEMPERATURE, now)
            self._sensor.feel(robot.measured, hot)
            for message in self._sensor.stream(now):
                self._line.send(self.name, message, now)
        self._line.flush(now)
