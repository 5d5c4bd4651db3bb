"""Emulator of a sensor on a serial port, independent of its protocol."""

import math
from collections.abc import Callable
from typing import Protocol

from valor.common.instance import Instance, Settings
from valor.common.messages import Proprioceptor
from valor.device_emulators.emulator import ALL_FAULTS, EmulatedFault, Emulator, FaultyLine
from valor.device_emulators.robot import SimulatedRobot
from valor.device_emulators.serial_port import SerialPort
from valor.devices.ports import serial_port

# Faults of a sensor that reports its temperature.
KINDS = ALL_FAULTS - {EmulatedFault.ENCODER_JUMP, EmulatedFault.UNDER_VOLTAGE}


class Timer:
    """Due times of periodic messages."""

    def __init__(self, period: float = 1.0) -> None:
        self.period = period  # [s]
        self.due = -math.inf  # of the next message [s]

    def restart(self) -> None:
        """Make the next message due at once."""
        self.due = -math.inf

    def advance(self, now: float) -> int:
        """Set the next due time; returns the number of messages that were due.

        Sensors of one rate are due at once, and so measure one state of the robot.
        """
        due = self.due if math.isfinite(self.due) else now - now % self.period
        count = 1 + int((now + 1e-9 - due) / self.period)
        self.due = due + count * self.period
        return count


class Sensor(Protocol):
    """Protocol of a sensor: responses to received bytes, and streamed messages."""

    def receive(self, data: bytes) -> list[bytes]:
        """Process bytes of the driver; returns the responses."""

    @property
    def due(self) -> float:
        """Time of the next message [s]; infinite: it does not stream."""

    def measure(self, measured: Proprioceptor, hot: bool) -> None:
        """Store the robot's measurements; ``hot``: overheated."""

    def stream(self, now: float) -> list[bytes]:
        """Messages due at ``now`` [s]."""


class SerialSensorEmulator(Emulator):
    """One sensor. Unplugged, it has no port and loses its settings."""

    def __init__(
        self,
        name: str,
        instance: Instance,
        settings: Settings,
        new: Callable[[], Sensor],
        kinds: frozenset[EmulatedFault] = KINDS,
    ) -> None:
        """``new``: returns a sensor after power-on; ``kinds``: faults that can be injected."""
        super().__init__(name, {name: kinds})
        self._port = SerialPort(serial_port(instance, settings, name))
        self._line = FaultyLine(self._port.write, self.faults)
        self._new, self._sensor = new, new()

    def files(self) -> tuple[int, ...]:
        return (self._port.fileno(),)

    def close(self) -> None:
        self._port.close()

    def step(self, now: float, robot: SimulatedRobot) -> None:
        if self.faults.active(self.name, EmulatedFault.UNPLUGGED, now):
            self._port.unplug()
            return
        if not self._port.plugged:
            self._sensor = self._new()
            self._port.plug()
        for reply in self._sensor.receive(self._port.read()):
            self._line.send(self.name, reply, now)
        if now >= self._sensor.due:
            hot = self.faults.active(self.name, EmulatedFault.OVER_TEMPERATURE, now)
            self._sensor.measure(robot.measured, hot)
            for message in self._sensor.stream(now):
                self._line.send(self.name, message, now)
        self._line.flush(now)
        self.due = min(self.due, self._sensor.due)
