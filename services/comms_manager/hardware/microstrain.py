"""The pelvis' inertial measurement unit: a MicroStrain 3DM-GX4-25 on a serial port.

It streams one packet a sample: attitude, angular rate, acceleration, and the state and time of its filter. Assumed, as
no manual can say it: it sits with its x axis forward and its z axis down, as the vendor draws it, and so turned half
about x from the robot's frame of the IMU; its heading is whatever it likes.
"""

from __future__ import annotations

import math
import struct
import time

import numpy as np

from valor.comms_manager.hardware.condition import require_identity
from valor.comms_manager.hardware.device import Ailment, DeviceContext, DeviceError, Fault, ImuMeasurement
from valor.comms_manager.hardware.mip import Packet, PacketStream, encode
from valor.comms_manager.hardware.serial_sensor import ANSWER_TIME, NoAnswerError, SerialSensor
from valor.devices.mip import (
    DATA_FIELDS,
    DEVICE_INFORMATION,
    FORMAT_ENTRY,
    Base,
    DescriptorSet,
    FilterData,
    FilterState,
    Function,
    MicroStrainMip,
    Reply,
    Result,
    Stream,
    ThreeDm,
)

UNIT_LENGTH = 0.01  # by which an attitude's norm may be off

_FIELDS = (
    FilterData.ATTITUDE_QUATERNION,
    FilterData.COMPENSATED_ANGULAR_RATE,
    FilterData.COMPENSATED_ACCELERATION,
    FilterData.STATUS,
    FilterData.GPS_TIMESTAMP,
)
_LAYOUTS = DATA_FIELDS[DescriptorSet.FILTER_DATA]
_HALF_TURN = np.array([1.0, -1.0, -1.0])  # about x, of a vector
_HALF_TURN_BOTH = np.array([1.0, 1.0, -1.0, -1.0])  # of a quaternion w, x, y, z, on both sides


class MicroStrain(SerialSensor):
    """One sensor, alone on its port."""

    def __init__(self, name: str, context: DeviceContext) -> None:
        table = context.robot.tables.devices[name]
        assert isinstance(table, MicroStrainMip)
        super().__init__(name, context, table.rate, table.baud_rate)
        self._table = table
        self._stream = PacketStream()
        self._skipped = 0
        self._filter_state = FilterState.RUNNING_VALID

    # --- start and end ------------------------------------------------------------------------------------------------

    def _wanted(self) -> str:
        table = self._table
        return f"a {table.model} with serial number {table.serial} and firmware {table.firmware} on {self._path}"

    def _begin(self, tries: int) -> None:
        self._ask(DescriptorSet.BASE, Base.SET_TO_IDLE, b"", tries)
        self._identify(tries)
        self._configure(tries)

    @property
    def _farewell(self) -> bytes:
        return encode(DescriptorSet.BASE, [(Base.SET_TO_IDLE, b"")])

    def _identify(self, tries: int) -> None:
        answer = self._ask(DescriptorSet.BASE, Base.DEVICE_INFORMATION, b"", tries)
        information = answer.get(Reply.DEVICE_INFORMATION, b"")
        if len(information) != DEVICE_INFORMATION.size:
            raise DeviceError(f"{self.name}: {len(information)} bytes of device information; expected {self._wanted()}")
        number, *texts = DEVICE_INFORMATION.unpack(information)
        model, _, serial_number, *_ = (text.decode("ascii", "replace").strip(" \0") for text in texts)
        firmware = f"{number // 1000}.{number // 100 % 10}.{number % 100}"
        table = self._table
        require_identity(
            self.name,
            {"model": model, "serial number": serial_number, "firmware": firmware},
            {"model": table.model, "serial number": table.serial, "firmware": table.firmware},
        )

    def _configure(self, tries: int) -> None:
        """Ask for the fields at the rate of robot.yaml, see that they are taken, and have them streamed."""
        answer = self._ask(DescriptorSet.THREE_DM, ThreeDm.FILTER_BASE_RATE, b"", tries)
        base_rate = int.from_bytes(answer.get(Reply.FILTER_BASE_RATE, b""), "big")
        decimation = round(base_rate / self._table.rate)
        if decimation < 1 or decimation * self._table.rate != base_rate:
            raise DeviceError(
                f"{self.name}: rate {self._table.rate:g} Hz (robot.yaml); "
                f"expected a whole fraction of its {base_rate} Hz"
            )
        entries = b"".join(FORMAT_ENTRY.pack(field, decimation) for field in _FIELDS)
        formatted = bytes((len(_FIELDS),)) + entries
        command = ThreeDm.FILTER_MESSAGE_FORMAT
        self._ask(DescriptorSet.THREE_DM, command, bytes((Function.APPLY,)) + formatted, tries)
        answer = self._ask(DescriptorSet.THREE_DM, command, bytes((Function.READ, 0)), tries)
        if answer.get(Reply.FILTER_MESSAGE_FORMAT) != formatted:
            raise DeviceError(f"{self.name}: it streams other fields than it was asked for")
        enable = bytes((Function.APPLY, Stream.FILTER, 1))
        self._ask(DescriptorSet.THREE_DM, ThreeDm.ENABLE_STREAM, enable, tries)
        self._ask(DescriptorSet.BASE, Base.RESUME, b"", tries)

    def _ask(self, descriptor_set: DescriptorSet, command: int, data: bytes, tries: int) -> dict[int, bytes]:
        """Send a command until it is acknowledged; returns the reply's other fields."""
        assert self._port is not None
        for _ in range(tries):
            self._port.write(encode(descriptor_set, [(command, data)]))
            deadline = time.monotonic() + ANSWER_TIME
            while (remaining := deadline - time.monotonic()) > 0.0:
                for packet in self._packets(self._read(remaining)):
                    if packet.descriptor_set != descriptor_set:
                        continue
                    fields = dict(packet.fields)
                    acknowledge = fields.get(Reply.ACKNOWLEDGE, b"")
                    if len(acknowledge) != 2 or acknowledge[0] != command:
                        continue
                    if acknowledge[1] != Result.OK:
                        raise DeviceError(
                            f"{self.name}: it refused the command {descriptor_set:#04x}/{command:#04x} "
                            f"with {acknowledge[1]:#04x}; expected {self._wanted()}"
                        )
                    return fields
        raise NoAnswerError(f"{self.name}: no answer within {tries * ANSWER_TIME:g} s; expected {self._wanted()}")

    # --- the thread ---------------------------------------------------------------------------------------------------

    def _forget(self) -> None:
        self._stream.clear()

    def _hear(self, data: bytes) -> None:
        for packet in self._packets(data):
            if packet.descriptor_set == DescriptorSet.FILTER_DATA and not self._take(packet):
                self._record.errors += 1

    def _packets(self, data: bytes) -> list[Packet]:
        """The packets that bytes complete; what is none is counted."""
        stream = self._stream
        wrong = stream.wrong_checksums + stream.malformed
        packets = list(stream.feed(data))
        wrong = stream.wrong_checksums + stream.malformed - wrong
        self._record.errors += wrong or int(stream.skipped > self._skipped)
        self._skipped = stream.skipped
        return packets

    def _take(self, packet: Packet) -> bool:
        """Take in a sample; returns whether it can be believed."""
        stamp = time.monotonic_ns()
        try:
            values = {field: _LAYOUTS[field].unpack(data) for field, data in packet.fields}
            *orientation, attitude_valid = values[FilterData.ATTITUDE_QUATERNION]
            *rate, rate_valid = values[FilterData.COMPENSATED_ANGULAR_RATE]
            *acceleration, acceleration_valid = values[FilterData.COMPENSATED_ACCELERATION]
            state = values[FilterData.STATUS][0]
            device_time = values[FilterData.GPS_TIMESTAMP][0]
        except (KeyError, struct.error):
            return False
        if state != self._filter_state:
            self._filter_state = state
            self.tell(self._filter_ailments())
        if state != FilterState.RUNNING_VALID or not (attitude_valid and rate_valid and acceleration_valid):
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

    def _filter_ailments(self) -> list[Ailment]:
        if self._filter_state == FilterState.RUNNING_VALID:
            return []
        return [Ailment(self.name, Fault.FAULTY, f"its filter is in state {self._filter_state}; expected it to run")]
