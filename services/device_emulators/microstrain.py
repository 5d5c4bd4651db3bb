"""Emulated MicroStrain IMU of the pelvis: commands, replies, and the stream of its filter."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.instance import Instance, Settings
from valor.common.messages import Proprioceptor
from valor.device_emulators.emulator import EmulatedFault
from valor.device_emulators.serial_sensor import KINDS, SerialSensorEmulator, Timer
from valor.devices.frame_stream import FrameStream
from valor.devices.mip import (
    APPLY,
    DEVICE_INFORMATION,
    FILTER_BASE_RATE,
    FILTER_STREAM,
    FORMAT_ENTRY,
    LAYOUTS,
    READ,
    RUNNING_VALID,
    STANDARD_GRAVITY,
    Base,
    DescriptorSet,
    FilterData,
    MicroStrainMip,
    Reply,
    Result,
    ThreeDm,
)
from valor.robot.description import RobotDescription

VALID = 1
Field = tuple[int, bytes]
Outcome = tuple[Result, list[Field]]  # of a command, with the other fields of its reply


class MipSensor:
    """Sensor in the vendor's frames: x forward, y right, z down, in a north-east-down (NED) world."""

    def __init__(self, model: str, serial: str, firmware: str) -> None:
        """``firmware``: version, such as 1.1.26."""
        major, minor, patch = (int(part) for part in firmware.split("."))
        self._information = DEVICE_INFORMATION.pack(
            1000 * major + 100 * minor + patch,
            *(text.encode("ascii").rjust(16) for text in (model, "6234-4220", serial, "I042Y", "5g,300d/s")),
        )
        self.orientation: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)  # w, x, y, z of the sensor in NED
        self.angular_velocity: tuple[float, ...] = (0.0, 0.0, 0.0)  # (3,) [rad/s]
        self.specific_force: tuple[float, ...] = (0.0, 0.0, -STANDARD_GRAVITY)  # (3,) [m/s²]
        self._entries: list[tuple[int, int]] = []  # of the stream: descriptor, decimation
        self._enabled = self._idle = False
        self._timer = Timer()
        self._frames = FrameStream(b"\x75\x65", 4, lambda header: header[3] + 6, _is_valid)
        self._started: float | None = None

    def receive(self, data: bytes) -> list[bytes]:
        return [self._reply(frame[2], frame[4:-2]) for frame in self._frames.feed(data)]

    def _reply(self, descriptor_set: int, payload: bytes) -> bytes:
        fields: list[Field] = []
        while len(payload) >= 2 and 2 <= payload[0] <= len(payload):
            command, data, payload = payload[1], payload[2 : payload[0]], payload[payload[0] :]
            result, replies = self._execute(descriptor_set, command, data)
            fields.append((Reply.ACKNOWLEDGE, bytes((command, result))))
            fields += replies
        return _frame(descriptor_set, fields)

    def _execute(self, descriptor_set: int, command: int, data: bytes) -> Outcome:
        handlers: dict[tuple[int, int], Callable[[bytes], Outcome]] = {
            (DescriptorSet.BASE, Base.PING): lambda _: (Result.OK, []),
            (DescriptorSet.BASE, Base.SET_TO_IDLE): lambda _: self._set_idle(True),
            (DescriptorSet.BASE, Base.RESUME): lambda _: self._set_idle(False),
            (DescriptorSet.BASE, Base.DEVICE_INFORMATION): lambda _: (
                Result.OK, [(Reply.DEVICE_INFORMATION, self._information)],
            ),
            (DescriptorSet.THREE_DM, ThreeDm.FILTER_BASE_RATE): lambda _: (
                Result.OK, [(Reply.FILTER_BASE_RATE, FILTER_BASE_RATE.to_bytes(2, "big"))],
            ),
            (DescriptorSet.THREE_DM, ThreeDm.FILTER_MESSAGE_FORMAT): self._format,
            (DescriptorSet.THREE_DM, ThreeDm.ENABLE_STREAM): self._enable_stream,
        }  # fmt: skip
        handler = handlers.get((descriptor_set, command))
        return (Result.UNKNOWN_COMMAND, []) if handler is None else handler(data)

    def _set_idle(self, idle: bool) -> Outcome:
        self._idle = idle
        return Result.OK, []

    def _format(self, data: bytes) -> Outcome:
        """Read or set the fields of the stream, which are sent together at their lowest rate."""
        if data[:1] == bytes((READ,)):
            packed = b"".join(FORMAT_ENTRY.pack(*entry) for entry in self._entries)
            return Result.OK, [(Reply.FILTER_MESSAGE_FORMAT, bytes((len(self._entries),)) + packed)]
        if len(data) < 2 or data[0] != APPLY or len(data) != 2 + data[1] * FORMAT_ENTRY.size:
            return Result.INVALID_PARAMETER, []
        entries: list[tuple[int, int]] = list(FORMAT_ENTRY.iter_unpack(data[2:]))
        if not entries or any(descriptor not in LAYOUTS or decimation < 1 for descriptor, decimation in entries):
            return Result.INVALID_PARAMETER, []
        self._entries = entries
        self._timer = Timer(max(decimation for _, decimation in entries) / FILTER_BASE_RATE)
        return Result.OK, []

    def _enable_stream(self, data: bytes) -> Outcome:
        if len(data) != 3 or data[:2] != bytes((APPLY, FILTER_STREAM)):
            return Result.INVALID_PARAMETER, []
        self._enabled = bool(data[2])
        self._timer.restart()
        return Result.OK, []

    def measure(self, measured: Proprioceptor, hot: bool) -> None:
        """Store the robot's measurements, of axes forward, left and up; the protocol has no temperature."""
        del hot
        w, x, y, z = measured.imu_orientation.tolist()
        self.orientation = w, x, -y, -z
        self.angular_velocity = _half_turn(measured.imu_angular_velocity)
        self.specific_force = _half_turn(measured.imu_linear_acceleration)

    @property
    def due(self) -> float:
        return self._timer.due if self._enabled and not self._idle and self._entries else math.inf

    def stream(self, now: float) -> list[bytes]:
        """Packet due at ``now`` [s], if any; missed packets are not sent."""
        if now < self.due:
            return []
        self._timer.advance(now)
        if self._started is None:
            self._started = now
        values: dict[int, Sequence[float]] = {
            FilterData.ATTITUDE_QUATERNION: (*self.orientation, VALID),
            FilterData.COMPENSATED_ANGULAR_RATE: (*self.angular_velocity, VALID),
            FilterData.COMPENSATED_ACCELERATION: (*self.specific_force, VALID),
            FilterData.STATUS: (RUNNING_VALID, 1, 0),
            FilterData.GPS_TIMESTAMP: (now - self._started, 0, 0),  # since power-on, as without GPS
        }
        fields = [(code, LAYOUTS[code].pack(*values[code])) for code, _ in self._entries]
        return [_frame(DescriptorSet.FILTER_DATA, fields)]


def _half_turn(vector: FloatArray) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, -y, -z


def _fletcher(data: bytes | bytearray) -> tuple[int, int]:
    """Fletcher checksum; the second sum contains byte i of n (n − i) times."""
    octets = np.frombuffer(bytes(data), dtype=np.uint8).astype(np.int64)
    return int(octets.sum() % 256), int((octets * np.arange(len(octets), 0, -1)).sum() % 256)


def _is_valid(frame: bytes | bytearray) -> bool:
    return _fletcher(frame[:-2]) == (frame[-2], frame[-1])


def _frame(descriptor_set: int, fields: Sequence[Field]) -> bytes:
    body = b"".join(bytes((2 + len(data), descriptor)) + data for descriptor, data in fields)
    frame = bytes((0x75, 0x65, descriptor_set, len(body))) + body
    return frame + bytes(_fletcher(frame))


class MicroStrainEmulator(SerialSensorEmulator):
    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        table = robot.tables.devices[name]
        assert isinstance(table, MicroStrainMip)

        def new() -> MipSensor:
            return MipSensor(table.model, table.serial, table.firmware)

        super().__init__(name, instance, settings, new, KINDS - {EmulatedFault.OVER_TEMPERATURE})
