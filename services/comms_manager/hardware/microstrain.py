"""MicroStrain 3DM-GX4-25 inertial measurement unit on a serial port.

Each sample is one packet: attitude, angular rate, acceleration, filter state and time. Assumed mounting: x axis
forward, z axis down, a half turn about x from the robot's IMU frame; its heading is arbitrary.
"""

import math
import struct
import time
from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from valor.comms_manager.hardware.condition import require_identity
from valor.comms_manager.hardware.device import DeviceContext, DeviceError, Fault, ImuMeasurement, UnitFault
from valor.comms_manager.hardware.serial_sensor import ANSWER_TIME, NoAnswerError, SerialSensor
from valor.devices.frame_stream import FrameStream
from valor.devices.mip import (
    APPLY,
    CHECKSUM_SIZE,
    DEVICE_INFORMATION,
    FILTER_STREAM,
    FORMAT_ENTRY,
    HEADER_SIZE,
    LAYOUTS,
    READ,
    RUNNING_VALID,
    SYNC,
    Base,
    DescriptorSet,
    FilterData,
    MicroStrainMip,
    Reply,
    Result,
    ThreeDm,
)

UNIT_LENGTH = 0.01  # largest error of the norm of an attitude
_HALF_TURN = np.array([1.0, -1.0, -1.0])  # about x, of a vector
_HALF_TURN_BOTH = np.array([1.0, 1.0, -1.0, -1.0])  # of a quaternion w, x, y, z, on both sides

Field = tuple[int, bytes]
"""Descriptor and data."""


class Packet(NamedTuple):
    """Packet with a valid checksum."""

    descriptor_set: int
    fields: tuple[Field, ...]


def checksum(data: bytes | bytearray) -> bytes:
    """Fletcher checksum of header and payload."""
    return bytes((sum(data) & 0xFF, sum(accumulate(data)) & 0xFF))


def encode(descriptor_set: int, fields: Sequence[Field]) -> bytes:
    """Bytes of a packet with up to 255 bytes of fields."""
    payload = b"".join(bytes((len(data) + 2, descriptor)) + data for descriptor, data in fields)
    frame = SYNC + bytes((descriptor_set, len(payload))) + payload
    return frame + checksum(frame)


def decode(frame: bytes) -> Packet | None:
    """Packet of a frame; None if its fields do not fill the payload."""
    fields = []
    payload = frame[HEADER_SIZE:-CHECKSUM_SIZE]
    while payload:
        length = payload[0]
        if not 2 <= length <= len(payload):
            return None
        fields.append((payload[1], payload[2:length]))
        payload = payload[length:]
    return Packet(frame[2], tuple(fields))


def packet_stream() -> FrameStream:
    return FrameStream(SYNC, HEADER_SIZE, lambda header: HEADER_SIZE + header[3] + CHECKSUM_SIZE, _is_valid)


def _is_valid(frame: bytes) -> bool:
    return checksum(frame[:-CHECKSUM_SIZE]) == frame[-CHECKSUM_SIZE:]


class MicroStrain(SerialSensor):
    """One sensor on a dedicated port."""

    def __init__(self, name: str, context: DeviceContext) -> None:
        table = context.robot.tables.devices[name]
        assert isinstance(table, MicroStrainMip)
        super().__init__(name, context, table.rate, table.baud_rate, packet_stream())
        self._table = table
        self._filter_state = RUNNING_VALID

    def _wanted(self) -> str:
        table = self._table
        return f"a {table.model} with serial number {table.serial} and firmware {table.firmware} on {self._path}"

    def _begin(self, tries: int) -> None:
        self._request(DescriptorSet.BASE, Base.SET_TO_IDLE, b"", tries)
        self._identify(tries)
        self._configure(tries)

    @property
    def _farewell(self) -> bytes:
        return encode(DescriptorSet.BASE, [(Base.SET_TO_IDLE, b"")])

    def _identify(self, tries: int) -> None:
        answer = self._request(DescriptorSet.BASE, Base.DEVICE_INFORMATION, b"", tries)
        information = answer.get(Reply.DEVICE_INFORMATION, b"")
        if len(information) != DEVICE_INFORMATION.size:
            raise DeviceError(f"{self.name}: {len(information)} bytes of device information; expected {self._wanted()}")
        number, *texts = DEVICE_INFORMATION.unpack(information)
        model, _, serial_number, *_ = (text.decode("ascii", "replace").strip(" \0") for text in texts)
        firmware = f"{number // 1000}.{number // 100 % 10}.{number % 100}"
        require_identity(self.name, self._table, model=model, serial=serial_number, firmware=firmware)

    def _configure(self, tries: int) -> None:
        """Request the fields at the rate of robot.yaml, check the setting, and start the stream."""
        answer = self._request(DescriptorSet.THREE_DM, ThreeDm.FILTER_BASE_RATE, b"", tries)
        base_rate = int.from_bytes(answer.get(Reply.FILTER_BASE_RATE, b""), "big")
        decimation = round(base_rate / self._table.rate)
        if decimation < 1 or decimation * self._table.rate != base_rate:
            raise DeviceError(
                f"{self.name}: rate {self._table.rate:g} Hz (robot.yaml); "
                f"expected a whole fraction of its {base_rate} Hz"
            )
        command = ThreeDm.FILTER_MESSAGE_FORMAT
        formatted = bytes((len(LAYOUTS),)) + b"".join(FORMAT_ENTRY.pack(field, decimation) for field in LAYOUTS)
        self._request(DescriptorSet.THREE_DM, command, bytes((APPLY,)) + formatted, tries)
        answer = self._request(DescriptorSet.THREE_DM, command, bytes((READ, 0)), tries)
        if answer.get(Reply.FILTER_MESSAGE_FORMAT) != formatted:
            raise DeviceError(f"{self.name}: it streams other fields than requested")
        self._request(DescriptorSet.THREE_DM, ThreeDm.ENABLE_STREAM, bytes((APPLY, FILTER_STREAM, 1)), tries)
        self._request(DescriptorSet.BASE, Base.RESUME, b"", tries)

    def _request(self, descriptor_set: DescriptorSet, command: int, data: bytes, tries: int) -> dict[int, bytes]:
        """Send a command until it is acknowledged; returns the reply's other fields."""
        assert self._port is not None
        for _ in range(tries):
            self._port.write(encode(descriptor_set, [(command, data)]))
            deadline = time.monotonic() + ANSWER_TIME
            while (remaining := deadline - time.monotonic()) > 0.0:
                for frame in self._frames(self._read(remaining)):
                    packet = decode(frame)
                    if packet is None or packet.descriptor_set != descriptor_set:
                        continue
                    fields = dict(packet.fields)
                    acknowledge = fields.get(Reply.ACKNOWLEDGE, b"")
                    if len(acknowledge) != 2 or acknowledge[0] != command:
                        continue
                    if acknowledge[1] != Result.OK:
                        raise DeviceError(
                            f"{self.name}: it rejected the command {descriptor_set:#04x}/{command:#04x} "
                            f"with {acknowledge[1]:#04x}; expected {self._wanted()}"
                        )
                    return fields
        raise NoAnswerError(f"{self.name}: no answer within {tries * ANSWER_TIME:g} s; expected {self._wanted()}")

    def _take(self, frame: bytes) -> bool:
        packet = decode(frame)
        if packet is None:
            return False
        return packet.descriptor_set != DescriptorSet.FILTER_DATA or self._take_sample(packet)

    def _take_sample(self, packet: Packet) -> bool:
        stamp = time.monotonic_ns()
        try:
            values = {field: LAYOUTS[field].unpack(data) for field, data in packet.fields}
            *orientation, attitude_valid = values[FilterData.ATTITUDE_QUATERNION]
            *rate, rate_valid = values[FilterData.COMPENSATED_ANGULAR_RATE]
            *acceleration, acceleration_valid = values[FilterData.COMPENSATED_ACCELERATION]
            state = values[FilterData.STATUS][0]
            device_time = values[FilterData.GPS_TIMESTAMP][0]
        except (KeyError, struct.error):
            return False
        if state != self._filter_state:
            self._filter_state = state
            text = f"its filter is in state {state}; expected it to run"
            self.report_faults([] if state == RUNNING_VALID else [UnitFault(self.name, Fault.FAULTY, text)])
        if state != RUNNING_VALID or not (attitude_valid and rate_valid and acceleration_valid):
            return False
        norm = math.hypot(*orientation)
        if not (abs(norm - 1.0) < UNIT_LENGTH and math.isfinite(sum(rate) + sum(acceleration))):
            return False
        late = self._lateness(device_time, stamp)
        if late is None:
            return False
        self.attitude = ImuMeasurement(
            stamp,
            np.array(orientation) * _HALF_TURN_BOTH / norm,
            np.array(rate) * _HALF_TURN,
            np.array(acceleration) * _HALF_TURN,
        )
        self._record.received(stamp)
        self._record.answered(late)
        return True
