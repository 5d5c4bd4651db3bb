"""A KVH 1750 in the pelvis, at the far end of its serial port.

Written from the manual's tables (``valor.devices.kvh``) without the driver's code: a mistake in one shows in the other.
"""

from __future__ import annotations

import numpy as np

from valor.common.instance import Instance, Settings
from valor.common.messages import Proprioceptor
from valor.device_emulators.serial_sensor import SerialSensorEmulator
from valor.devices.kvh import HEADER, MESSAGE, RATES, STANDARD_GRAVITY, Kvh1750
from valor.robot.description import RobotDescription

ROOM, FEVER = 34, 90  # [°C]
_LONGEST_LINE = 256  # more without an end is no command
_VALUES = {"ROTFMT": ("DELTA", "RATE"), "ROTUNITS": ("RAD", "DEG"), "TEMPUNITS": ("C", "F")}


class KvhSensor:
    """The sensor behind its serial line; lines of text in, answers and messages out.

    Attributes:
        temperature: [°C].
        rotation: what it feels: angular velocity [rad/s].
        acceleration: specific force [m/s²].
        configuring: in configuration mode; it is silent then.
    """

    def __init__(self, serial: str) -> None:
        self._serial = serial
        self.temperature = ROOM
        self.rotation, self.acceleration = np.zeros(3), np.array([0.0, 0.0, STANDARD_GRAVITY])
        self.configuring = False
        self._settings = {"ROTFMT": "DELTA", "ROTUNITS": "RAD", "TEMPUNITS": "C", "DR": "1000"}  # as it is delivered
        self._received = bytearray()
        self._due: float | None = None  # [s]
        self._sequence = -1

    def receive(self, data: bytes) -> list[bytes]:
        """Take bytes of the driver; returns an answer for each line that has one."""
        self._received += data.replace(b"\r", b"\n")
        *lines, rest = bytes(self._received).split(b"\n")
        self._received = bytearray(rest[-_LONGEST_LINE:])
        answers = [self._obey(line.decode("ascii", "replace").strip().upper()) for line in lines if line.strip()]
        return [answer.encode() + b"\r\n" for answer in answers if answer]

    def _obey(self, line: str) -> str:
        if line == "=CONFIG,1":
            self.configuring, self._due = True, None
            return "CONFIG,1"
        if not self.configuring:
            return ""
        if line == "=CONFIG,0":
            self.configuring = False
            return ""
        word, _, value = line[1:].partition(",")
        if line == "?IS":
            return f"IS,{self._serial}"
        known = _VALUES.get(word, tuple(map(str, RATES)) if word == "DR" else ())
        if line[0] == "?" and word in self._settings:
            return f"{word},{self._settings[word]}"
        if line[0] != "=" or value not in known:
            return f"INVALID,{line}"
        self._settings[word] = value
        return f"{word},{value}"

    def is_due(self, now: float) -> bool:
        """Whether a message is due at ``now`` [s]."""
        return not self.configuring and (self._due is None or now + 1e-9 >= self._due)

    def feel(self, measured: Proprioceptor, hot: bool) -> None:
        """What the robot's IMU feels, and whether it is too hot."""
        self.temperature = FEVER if hot else ROOM
        self.rotation, self.acceleration = measured.imu_angular_velocity, measured.imu_linear_acceleration

    def stream(self, now: float) -> list[bytes]:
        """The message that is due at ``now`` [s]; those that were missed are counted, and not made up."""
        if not self.is_due(now):
            return []
        period = 1.0 / int(self._settings["DR"])
        missed = 0 if self._due is None else int((now + 1e-9 - self._due) / period)
        self._due = (now if self._due is None else self._due) + (missed + 1) * period
        self._sequence = (self._sequence + missed + 1) & 0x7F
        turn = self.rotation * (period if self._settings["ROTFMT"] == "DELTA" else 1.0)
        if self._settings["ROTUNITS"] == "DEG":
            turn = np.degrees(turn)
        celsius = self.temperature
        said = celsius if self._settings["TEMPUNITS"] == "C" else round(1.8 * celsius + 32.0)
        body = MESSAGE.pack(HEADER, *turn, *(self.acceleration / STANDARD_GRAVITY), 0x77, self._sequence, said)
        return [body + crc32(body).to_bytes(4, "big")]


class KvhEmulator(SerialSensorEmulator):
    """One sensor."""

    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        table = robot.tables.devices[name]
        assert isinstance(table, Kvh1750)
        super().__init__(name, instance, settings, lambda: KvhSensor(table.serial))


def crc32(data: bytes) -> int:
    """Bit by bit, as the manual has it: 0x04C11DB7 from 0xFFFFFFFF, most significant bit first."""
    crc = 0xFFFFFFFF
    for octet in data:
        crc ^= octet << 24
        for _ in range(8):
            crc = (crc << 1 ^ 0x04C11DB7 if crc & 0x80000000 else crc << 1) & 0xFFFFFFFF
    return crc
