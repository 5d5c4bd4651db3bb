"""What a 3DM-GX4-25 makes of the bytes that it is sent, and the packets that it streams.

Written from the manual's tables (``valor.devices.mip``) without the driver's code: a mistake in one shows in the
other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.messages import Proprioceptor
from valor.devices.frame_stream import FrameStream
from valor.devices.mip import (
    DATA_FIELDS,
    DEVICE_INFORMATION,
    FILTER_BASE_RATE,
    FORMAT_ENTRY,
    IMU_BASE_RATE,
    STANDARD_GRAVITY,
    Base,
    DescriptorSet,
    FilterData,
    FilterState,
    Function,
    ImuData,
    Reply,
    Result,
    Stream,
    ThreeDm,
)

VALID = 1


@dataclass
class Attitude:
    """What the sensor feels, in the vendor's frames: x forward, y right, z down; north-east-down outside."""

    orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)  # w, x, y, z of the sensor in NED
    angular_velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [rad/s]
    specific_force: tuple[float, float, float] = (0.0, 0.0, -STANDARD_GRAVITY)  # [m/s²]

    @classmethod
    def of_pelvis(cls, orientation: FloatArray, rate: FloatArray, specific_force: FloatArray) -> Attitude:
        """From axes that point forward, left and up, in a world whose z points up."""
        w, x, y, z = orientation.tolist()
        return cls((w, x, -y, -z), _half_turn(rate), _half_turn(specific_force))

    def matrix(self) -> tuple[float, ...]:
        """(9,) M, row after row: vector in sensor = M · vector in NED."""
        w, x, y, z = self.orientation
        return (
            w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y),
            2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x),
            2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z,
        )  # fmt: skip


@dataclass
class _Stream:
    """A data stream: which fields, which share the lowest rate among them, and when the next packet is due."""

    base_rate: int  # [Hz]
    entries: list[tuple[int, int]] = field(default_factory=list)  # descriptor, decimation
    enabled: bool = False
    due: float | None = None  # [s]

    @property
    def period(self) -> float:
        """[s]."""
        return max(decimation for _, decimation in self.entries) / self.base_rate

    def is_due(self, now: float) -> bool:
        """Whether a packet is due at ``now`` [s]."""
        return self.enabled and bool(self.entries) and (self.due is None or now + 1e-9 >= self.due)

    def take_due(self, now: float) -> bool:
        """Whether a packet is due, which is then taken to be sent; packets that were missed are not made up."""
        if not self.is_due(now):
            return False
        periods = 0 if self.due is None else int((now + 1e-9 - self.due) / self.period)
        self.due = (now if self.due is None else self.due) + (periods + 1) * self.period
        return True


class MipSensor:
    """The sensor behind its serial line; commands in, replies and streams out.

    Attributes:
        attitude: what it feels now.
    """

    def __init__(self, model: str, serial: str, firmware: str) -> None:
        """``firmware``: as people write it, 1.1.26."""
        major, minor, patch = (int(part) for part in firmware.split("."))
        self._information = DEVICE_INFORMATION.pack(
            1000 * major + 100 * minor + patch,
            *(text.encode("ascii").rjust(16) for text in (model, "6234-4220", serial, "I042Y", "5g,300d/s")),
        )
        self.attitude = Attitude()
        self._streams = {Stream.IMU: _Stream(IMU_BASE_RATE), Stream.FILTER: _Stream(FILTER_BASE_RATE)}
        self._idle = False
        self._frames = FrameStream(b"\x75\x65", 4, lambda header: header[3] + 6, _sound)
        self._now = 0.0
        self._started: float | None = None

    # --- commands -----------------------------------------------------------------------------------------------------

    def receive(self, data: bytes) -> list[bytes]:
        """Take bytes of the driver; returns a reply packet for each command packet."""
        return [self._answer(frame[2], frame[4:-2]) for frame in self._frames.feed(data)]

    def _answer(self, descriptor_set: int, payload: bytes) -> bytes:
        fields: list[tuple[int, bytes]] = []
        while len(payload) >= 2 and 2 <= payload[0] <= len(payload):
            command, data, payload = payload[1], payload[2 : payload[0]], payload[payload[0] :]
            result, answers = self._execute(descriptor_set, command, data)
            fields.append((Reply.ACKNOWLEDGE, bytes((command, result))))
            fields += answers
        return _frame(descriptor_set, fields)

    def _execute(self, descriptor_set: int, command: int, data: bytes) -> tuple[Result, list[tuple[int, bytes]]]:
        handlers: dict[tuple[int, int], Callable[[bytes], tuple[Result, list[tuple[int, bytes]]]]] = {
            (DescriptorSet.BASE, Base.PING): lambda _: (Result.OK, []),
            (DescriptorSet.BASE, Base.SET_TO_IDLE): lambda _: self._set_idle(True),
            (DescriptorSet.BASE, Base.RESUME): lambda _: self._set_idle(False),
            (DescriptorSet.BASE, Base.RESET): lambda _: self._reset(),
            (DescriptorSet.BASE, Base.DEVICE_INFORMATION): lambda _: (
                Result.OK, [(Reply.DEVICE_INFORMATION, self._information)],
            ),
            (DescriptorSet.THREE_DM, ThreeDm.IMU_BASE_RATE): lambda _: (
                Result.OK, [(Reply.IMU_BASE_RATE, IMU_BASE_RATE.to_bytes(2, "big"))],
            ),
            (DescriptorSet.THREE_DM, ThreeDm.FILTER_BASE_RATE): lambda _: (
                Result.OK, [(Reply.FILTER_BASE_RATE, FILTER_BASE_RATE.to_bytes(2, "big"))],
            ),
            (DescriptorSet.THREE_DM, ThreeDm.IMU_MESSAGE_FORMAT): lambda data: self._format(
                data, Stream.IMU, DescriptorSet.IMU_DATA, Reply.IMU_MESSAGE_FORMAT
            ),
            (DescriptorSet.THREE_DM, ThreeDm.FILTER_MESSAGE_FORMAT): lambda data: self._format(
                data, Stream.FILTER, DescriptorSet.FILTER_DATA, Reply.FILTER_MESSAGE_FORMAT
            ),
            (DescriptorSet.THREE_DM, ThreeDm.ENABLE_STREAM): self._enable_stream,
        }  # fmt: skip
        handler = handlers.get((descriptor_set, command))
        return (Result.UNKNOWN_COMMAND, []) if handler is None else handler(data)

    def _set_idle(self, idle: bool) -> tuple[Result, list[tuple[int, bytes]]]:
        self._idle = idle
        return Result.OK, []

    def _reset(self) -> tuple[Result, list[tuple[int, bytes]]]:
        for stream in self._streams.values():
            stream.entries, stream.enabled, stream.due = [], False, None
        self._idle = False
        return Result.OK, []

    def _format(
        self, data: bytes, which: Stream, descriptor_set: DescriptorSet, reply: Reply
    ) -> tuple[Result, list[tuple[int, bytes]]]:
        stream = self._streams[which]
        if len(data) < 2 or data[0] not in (Function.APPLY, Function.READ):
            return Result.INVALID_PARAMETER, []
        if data[0] == Function.READ:
            packed = b"".join(FORMAT_ENTRY.pack(*entry) for entry in stream.entries)
            return Result.OK, [(reply, bytes((len(stream.entries),)) + packed)]
        count, rest = data[1], data[2:]
        if len(rest) != count * FORMAT_ENTRY.size:
            return Result.INVALID_PARAMETER, []
        entries: list[tuple[int, int]] = list(FORMAT_ENTRY.iter_unpack(rest))
        known = DATA_FIELDS[descriptor_set]
        if any(descriptor not in known or decimation < 1 for descriptor, decimation in entries):
            return Result.INVALID_PARAMETER, []
        stream.entries, stream.due = entries, None
        return Result.OK, []

    def _enable_stream(self, data: bytes) -> tuple[Result, list[tuple[int, bytes]]]:
        if len(data) < 2 or data[1] not in (Stream.IMU, Stream.FILTER):
            return Result.INVALID_PARAMETER, []
        stream = self._streams[Stream(data[1])]
        if data[0] == Function.READ:
            return Result.OK, [(Reply.STREAM_ENABLED, bytes((data[1], stream.enabled)))]
        if data[0] != Function.APPLY or len(data) != 3:
            return Result.INVALID_PARAMETER, []
        stream.enabled, stream.due = bool(data[2]), None
        return Result.OK, []

    # --- streams ------------------------------------------------------------------------------------------------------

    def feel(self, measured: Proprioceptor, hot: bool) -> None:
        """What the robot's IMU feels; it does not say how warm it is."""
        del hot
        self.attitude = Attitude.of_pelvis(
            measured.imu_orientation, measured.imu_angular_velocity, measured.imu_linear_acceleration
        )

    def is_due(self, now: float) -> bool:
        """Whether ``stream`` would give anything at ``now`` [s]."""
        return not self._idle and any(stream.is_due(now) for stream in self._streams.values())

    def stream(self, now: float) -> list[bytes]:
        """The data packets that are due at ``now`` [s]."""
        self._now = now
        if self._idle:
            return []
        packets = []
        if self._streams[Stream.IMU].take_due(now):
            packets.append(self._data(DescriptorSet.IMU_DATA, Stream.IMU))
        if self._streams[Stream.FILTER].take_due(now):
            packets.append(self._data(DescriptorSet.FILTER_DATA, Stream.FILTER))
        return packets

    def _data(self, descriptor_set: DescriptorSet, which: Stream) -> bytes:
        values = self._imu_values() if which == Stream.IMU else self._filter_values()
        layouts = DATA_FIELDS[descriptor_set]
        entries = self._streams[which].entries
        return _frame(descriptor_set, [(code, layouts[code].pack(*values[code]())) for code, _ in entries])

    def _time(self) -> tuple[float, int, int]:
        """Time of week since the sensor was switched on: it has no GPS."""
        if self._started is None:
            self._started = self._now
        return self._now - self._started, 0, 0

    def _imu_values(self) -> dict[int, Callable[[], Iterable[float]]]:
        feels = self.attitude
        return {
            ImuData.SCALED_ACCELEROMETER: lambda: [a / STANDARD_GRAVITY for a in feels.specific_force],
            ImuData.SCALED_GYROSCOPE: lambda: feels.angular_velocity,
            ImuData.ORIENTATION_MATRIX: feels.matrix,
            ImuData.QUATERNION: lambda: feels.orientation,
            ImuData.GPS_TIMESTAMP: self._time,
        }

    def _filter_values(self) -> dict[int, Callable[[], Iterable[float]]]:
        feels = self.attitude
        return {
            FilterData.ATTITUDE_QUATERNION: lambda: (*feels.orientation, VALID),
            FilterData.ATTITUDE_MATRIX: lambda: (*feels.matrix(), VALID),
            FilterData.COMPENSATED_ANGULAR_RATE: lambda: (*feels.angular_velocity, VALID),
            FilterData.STATUS: lambda: (FilterState.RUNNING_VALID, 1, 0),
            FilterData.GPS_TIMESTAMP: self._time,
            FilterData.COMPENSATED_ACCELERATION: lambda: (*feels.specific_force, VALID),
        }


def _half_turn(vector: FloatArray) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, -y, -z


def _fletcher(data: bytes | bytearray) -> tuple[int, int]:
    """Byte i of n is in the second sum n − i times."""
    octets = np.frombuffer(bytes(data), dtype=np.uint8).astype(np.int64)
    return int(octets.sum() % 256), int((octets * np.arange(len(octets), 0, -1)).sum() % 256)


def _sound(frame: bytes | bytearray) -> bool:
    return _fletcher(frame[:-2]) == (frame[-2], frame[-1])


def _frame(descriptor_set: int, fields: Iterable[tuple[int, bytes]]) -> bytes:
    body = bytearray()
    for descriptor, data in fields:
        body += bytes((2 + len(data), descriptor))
        body += data
    frame = bytearray((0x75, 0x65, descriptor_set, len(body))) + body
    return bytes(frame) + bytes(_fletcher(frame))
