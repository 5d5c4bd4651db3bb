"""Emulated KVH 1750 in the pelvis.

Implements the tables of the manual (``valor.devices.kvh``) independently of the driver, so that tests find mistakes.
"""

import math

import numpy as np

from valor.common.instance import Instance, Settings
from valor.common.messages import Proprioceptor
from valor.device_emulators.serial_sensor import SerialSensorEmulator, Timer
from valor.devices.kvh import HEADER, MESSAGE, RATES, STANDARD_GRAVITY, Kvh1750
from valor.robot.description import RobotDescription

NORMAL, HOT = 34, 90  # [°C]
_VALUES = {"ROTFMT": ("DELTA", "RATE"), "ROTUNITS": ("RAD",), "TEMPUNITS": ("C",), "DR": tuple(map(str, RATES))}


class KvhSensor:
    """Sensor: receives lines of text, sends responses and messages."""

    def __init__(self, serial: str) -> None:
        self._serial = serial
        self.temperature = NORMAL  # [°C]
        self.rotation = np.zeros(3)  # [rad/s]
        self.acceleration = np.array([0.0, 0.0, STANDARD_GRAVITY])  # specific force [m/s²]
        self.configuring = False  # in configuration mode, without messages
        self._is_rate = False  # by factory settings, rotations are angles since the last message
        self._received = b""
        self._timer = Timer(1e-3)
        self._sequence = -1

    def receive(self, data: bytes) -> list[bytes]:
        *lines, self._received = (self._received + data.replace(b"\r", b"\n")).split(b"\n")
        responses = [self._execute(line.decode("ascii", "replace").strip().upper()) for line in lines if line.strip()]
        return [response.encode() + b"\r\n" for response in responses if response]

    def _execute(self, line: str) -> str:
        if line == "=CONFIG,1":
            self.configuring = True
            self._timer.restart()
            return "CONFIG,1"
        if not self.configuring:
            return ""
        if line == "=CONFIG,0":
            self.configuring = False
            return ""
        if line == "?IS":
            return f"IS,{self._serial}"
        name, _, value = line[1:].partition(",")
        if line[0] != "=" or value not in _VALUES.get(name, ()):
            return f"INVALID,{line}"
        if name == "DR":
            self._timer = Timer(1.0 / int(value))
        elif name == "ROTFMT":
            self._is_rate = value == "RATE"
        return f"{name},{value}"

    @property
    def due(self) -> float:
        return math.inf if self.configuring else self._timer.due

    def measure(self, measured: Proprioceptor, hot: bool) -> None:
        self.temperature = HOT if hot else NORMAL
        self.rotation, self.acceleration = measured.imu_angular_velocity, measured.imu_linear_acceleration
        if measured.kvh_angular_velocity.size:
            self.rotation, self.acceleration = measured.kvh_angular_velocity, measured.kvh_linear_acceleration

    def stream(self, now: float) -> list[bytes]:
        """Message due at ``now`` [s], if any; missed messages advance the sequence number and are not sent."""
        if now < self.due:
            return []
        self._sequence = (self._sequence + self._timer.advance(now)) & 0x7F
        rotation = self.rotation * (1.0 if self._is_rate else self._timer.period)
        body = MESSAGE.pack(
            HEADER, *rotation, *(self.acceleration / STANDARD_GRAVITY), 0x77, self._sequence, self.temperature
        )
        return [body + crc32(body).to_bytes(4, "big")]


class KvhEmulator(SerialSensorEmulator):
    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        table = robot.tables.devices[name]
        assert isinstance(table, Kvh1750)
        super().__init__(name, instance, settings, lambda: KvhSensor(table.serial))


def crc32(data: bytes) -> int:
    """CRC-32 of the manual: polynomial 0x04C11DB7, start 0xFFFFFFFF, most significant bit first."""
    crc = 0xFFFFFFFF
    for octet in data:
        crc = (crc << 8 & 0xFFFFFFFF) ^ _REMAINDERS[crc >> 24 ^ octet]
    return crc


def _remainder(octet: int) -> int:
    crc = octet << 24
    for _ in range(8):
        crc = (crc << 1 ^ 0x04C11DB7 if crc & 0x80000000 else crc << 1) & 0xFFFFFFFF
    return crc


_REMAINDERS = [_remainder(octet) for octet in range(256)]
