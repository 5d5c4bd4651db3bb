"""The pelvis' inertial measurement unit: a MicroStrain 3DM-GX4-25 on a serial port.

It streams one packet a sample: attitude, angular rate, acceleration, and the state and time of its filter. Assumed, as
no manual can say it: it sits with its x axis forward and its z axis down, as the vendor draws it, and so turned half
about x from the robot's frame of the IMU; its heading is whatever it likes.
"""

from __future__ import annotations

import contextlib
import math
import select
import struct
import termios
import time
from threading import Event

import numpy as np
import serial

from valor.comms_manager.hardware.condition import require_identity
from valor.comms_manager.hardware.device import (
    Ailment,
    Device,
    DeviceContext,
    DeviceError,
    Fault,
    ImuMeasurement,
    UnitRecord,
)
from valor.comms_manager.hardware.device_clock import DeviceClock
from valor.comms_manager.hardware.mip import Packet, PacketStream, encode
from valor.devices.mip import (
    DATA_FIELDS,
    DEVICE_INFORMATION,
    FORMAT_ENTRY,
    Base,
    DescriptorSet,
    FilterData,
    FilterState,
    Function,
    Reply,
    Result,
    Stream,
    ThreeDm,
)
from valor.devices.ports import serial_port
from valor.devices.table import MicroStrainMip

ANSWER_TIME = 0.1  # of a command [s]
TRIES = 10  # of a command, at start
LATEST = 0.02  # a packet that is held up longer is not used [s]
RETRY_PERIOD = 0.5  # between attempts to find a sensor that is gone [s]
STREAM_LOST = 1.0  # without a packet, after which it is asked to stream again [s]
UNIT_LENGTH = 0.01  # by which an attitude's norm may be off
_WAIT = 0.02  # longest sleep of the thread [s]
_READ = 4096

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


class NoAnswerError(DeviceError):
    """The sensor does not answer a command."""


class MicroStrain(Device):
    """One sensor, alone on its port."""

    def __init__(self, name: str, context: DeviceContext) -> None:
        super().__init__(name, context)
        table = context.robot.tables.devices[name]
        assert isinstance(table, MicroStrainMip)
        self._table = table
        self._path = serial_port(context.instance, context.settings, name)
        self._record = UnitRecord(name)
        self.records = (self._record,)
        self.rate = table.rate
        self._port: serial.Serial | None = None
        self._stream = PacketStream()
        self._clock = DeviceClock()
        self._skipped = 0
        self._looked = math.inf  # at the port, last; before the first time, never [monotonic s]
        self._away = 0.0  # how long nobody had looked, beyond what the thread sleeps, before it did now [s]
        self._filter_state = FilterState.RUNNING_VALID

    # --- start and end ------------------------------------------------------------------------------------------------

    def find(self) -> None:
        """Check model, serial number and firmware, have it stream, and get a first sample."""
        self._connect(TRIES)
        deadline = time.monotonic() + TRIES * ANSWER_TIME
        while self.measured is None:
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"{self.name}: it says who it is, but no sound sample came; expected {self._wanted()}"
                )
            self._listen(ANSWER_TIME)

    def close(self) -> None:
        """Have it be quiet, and close the port."""
        if self._port is not None:
            with contextlib.suppress(serial.SerialException, OSError):  # it is gone: it is quiet
                self._port.write(encode(DescriptorSet.BASE, [(Base.SET_TO_IDLE, b"")]))
            self._disconnect()
        super().close()

    def _wanted(self) -> str:
        table = self._table
        return f"a {table.model} with serial number {table.serial} and firmware {table.firmware} on {self._path}"

    def _connect(self, tries: int) -> None:
        try:
            self._port = serial.Serial(
                str(self._path), self._table.baud_rate, timeout=0, write_timeout=ANSWER_TIME, exclusive=True
            )
        except (serial.SerialException, OSError) as error:
            raise DeviceError(
                f"{self.name}: {self._path} cannot be opened: {error}; expected {self._wanted()}"
            ) from None
        try:
            self._stream.clear()
            self._clock.reset()
            self._ask(DescriptorSet.BASE, Base.SET_TO_IDLE, b"", tries)
            self._identify(tries)
            self._configure(tries)
        except (DeviceError, serial.SerialException, OSError):
            self._disconnect()
            raise

    def _disconnect(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

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
                for packet in self._receive(remaining):
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

    def run(self, stopping: Event) -> None:
        """Take samples in until told to stop; find the sensor again when it is gone."""
        looked = time.monotonic()
        self._forget()
        while not stopping.is_set():
            try:
                if self._port is not None:
                    self._listen(_WAIT)
                now = time.monotonic()
                lost = self._port is None or now - 1e-9 * self._record.stamp > STREAM_LOST
                if lost and now - looked > RETRY_PERIOD:
                    looked = now
                    self._disconnect()
                    self._connect(tries=1)
                    self.tell([])
                elif self._port is None:
                    stopping.wait(_WAIT)
                    self.looks += 1
            except (serial.SerialException, OSError):
                self._disconnect()
                self.tell([Ailment(self.name, Fault.UNPLUGGED, f"{self._path} is gone")])
            except NoAnswerError:
                continue  # it is silent, and told to be
            except DeviceError as error:
                if self._path.exists():
                    self.tell([Ailment(self.name, Fault.FAULTY, str(error).removeprefix(f"{self.name}: "))])

    def _forget(self) -> None:
        """Throw away what came while other devices were found: seconds of samples, each too late to be used."""
        with contextlib.suppress(serial.SerialException, termios.error):  # it is gone: that is found out soon
            if self._port is not None:
                self._port.reset_input_buffer()
        self._stream.clear()

    def _listen(self, timeout: float) -> None:
        for packet in self._receive(timeout):
            if packet.descriptor_set == DescriptorSet.FILTER_DATA and not self._take(packet):
                self._record.errors += 1
        self.looks += 1

    def _receive(self, timeout: float) -> list[Packet]:
        """The packets that are complete by the first bytes which come within a time [s]."""
        assert self._port is not None
        ready, _, _ = select.select((self._port.fileno(), self.woken), (), (), timeout)
        # The kernel hands a terminal's bytes over by a worker of low priority, and ``select`` waits for that one beyond
        # its own time-out: on a busy computer for longer than this thread does for its turn.
        now = time.monotonic()
        self._away, self._looked = max(0.0, now - self._looked - _WAIT), now
        if self.woken in ready:
            self.drain_wake()
        if self._port.fileno() not in ready:
            return []
        stream = self._stream
        wrong = stream.wrong_checksums + stream.malformed
        packets = list(stream.feed(self._port.read(_READ)))
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
        late = self._clock.lateness(device_time, 1e-9 * stamp) if math.isfinite(device_time) else None
        if late is None or late > LATEST + self._away:  # what lay here, unread, is not the sensor's to answer for
            return False
        self.measured = ImuMeasurement(
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
