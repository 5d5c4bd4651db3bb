"""An inertial measurement unit of KVH's, a 1750, on a serial port; its attitude is made of its rates here.

Assumed, as no manual can say it: it sits where the robot's frame of the IMU is, with its x axis forward and its z axis
up; its heading begins at 0.
"""

from __future__ import annotations

import math
import re
import time

import numpy as np

from valor.common.rotation import Vector
from valor.comms_manager.hardware.attitude_filter import AttitudeFilter
from valor.comms_manager.hardware.condition import Condition, Limits, require_identity
from valor.comms_manager.hardware.device import Ailment, DeviceContext, DeviceError, Fault, ImuMeasurement
from valor.comms_manager.hardware.serial_sensor import ANSWER_TIME, NoAnswerError, SerialSensor
from valor.devices.frame_stream import FrameStream
from valor.devices.kvh import (
    CRC_POLYNOMIAL,
    CRC_SIZE,
    CRC_START,
    HEADER,
    MESSAGE,
    SEQUENCES,
    STANDARD_GRAVITY,
    VALID,
    WARMEST,
    Kvh1750,
)

FASTEST, STRONGEST = 20.0, 200.0  # more is nonsense: 490 °/s and 10 g are what it measures [rad/s, m/s²]
WARM = 5.0  # below its limit, from which on it is warm [K]
GRACE = 0.15  # without an attitude, as it finds it anew, until that is told [s]
_ATTITUDE_WITHIN = 5.0  # at start, while it is at rest [s]


class Kvh(SerialSensor):
    """One sensor, alone on its port."""

    first_sample = _ATTITUDE_WITHIN

    def __init__(self, name: str, context: DeviceContext) -> None:
        table = context.robot.tables.devices[name]
        assert isinstance(table, Kvh1750)
        super().__init__(name, context, table.rate, table.baud_rate)
        self._table = table
        self._stream = FrameStream(HEADER, len(HEADER), lambda _: MESSAGE.size + CRC_SIZE, _is_sound)
        self._filter = AttitudeFilter()
        self._condition = Condition(self._record, Limits(WARMEST - WARM, WARMEST, -math.inf))
        self._messages = 0  # by its own count, since it was found
        self._sequence: int | None = None
        self._came = 0.0  # the newest message [monotonic s]
        self._oriented = 0.0  # when it had an attitude last [monotonic s]

    # --- start and end ------------------------------------------------------------------------------------------------

    def _wanted(self) -> str:
        return f"a KVH 1750 with serial number {self._table.serial} on {self._path}, at rest"

    def _begin(self, tries: int) -> None:
        self._ask("=CONFIG,1", tries)
        require_identity(self.name, {"serial number": self._ask("?IS", tries)}, {"serial number": self._table.serial})
        for command in ("=ROTFMT,RATE", "=ROTUNITS,RAD", "=TEMPUNITS,C", f"=DR,{self._table.rate}"):
            self._ask(command, tries)
        assert self._port is not None
        self._port.write(b"=CONFIG,0\n")  # which it does not answer
        self._filter.reset()

    @property
    def _is_known(self) -> bool:
        return self.attitude is not None

    @property
    def _farewell(self) -> bytes:
        return b"=CONFIG,1\n"

    def _ask(self, command: str, tries: int) -> str:
        """Send a command, or a query, until it is answered; returns what the answer says."""
        assert self._port is not None
        word = command[1:].partition(",")[0]
        answer = re.compile(rb"(INVALID|" + word.encode() + rb"),([^\r\n]*)[\r\n]")
        for _ in range(tries):
            self._port.write(command.encode() + b"\n")
            deadline, said = time.monotonic() + ANSWER_TIME, b""
            while (remaining := deadline - time.monotonic()) > 0.0:
                said += self._read(remaining)
                if (found := answer.search(said)) is None:
                    continue
                value = found[2].decode("ascii", "replace").strip()
                if found[1] == b"INVALID" or (command[0] == "=" and value != command.partition(",")[2]):
                    raise DeviceError(f"{self.name}: it answers {command} with {value!r}; expected {self._wanted()}")
                return value
        raise NoAnswerError(f"{self.name}: no answer within {tries * ANSWER_TIME:g} s; expected {self._wanted()}")

    # --- the thread ---------------------------------------------------------------------------------------------------

    def _forget(self) -> None:
        self._stream.clear()

    def _hear(self, data: bytes) -> None:
        stream = self._stream
        unsound, skipped = stream.unsound, stream.skipped
        for message in stream.feed(data):
            if not self._take(message):
                self._record.errors += 1
        self._record.errors += (stream.unsound - unsound) or int(stream.skipped > skipped)

    def _take(self, message: bytes) -> bool:
        """Take in a sample; returns whether it can be believed."""
        stamp = time.monotonic_ns()
        _, *values, status, sequence, temperature = MESSAGE.unpack_from(message)
        rate, force = _vector(values[:3], 1.0), _vector(values[3:], STANDARD_GRAVITY)
        self._judge(status, temperature, 1e-9 * stamp)
        if status != VALID or not (math.hypot(*rate) < FASTEST and math.hypot(*force) < STRONGEST):
            return False
        passed = self._passed(sequence, 1e-9 * stamp)
        late = self._lateness(self._messages / self.rate, stamp)
        if not passed:
            return False
        self._filter.update(rate, force, passed / self.rate)  # late ones too: it happened
        if late is None:
            return False
        self._record.received(stamp)
        self._record.answered(late)
        if self._filter.orientation is not None:
            self._oriented = self._came
            self.attitude = ImuMeasurement(stamp, np.array(self._filter.orientation), np.array(rate), np.array(force))
        return True

    def _passed(self, sequence: int, now: float) -> int:
        """How many messages further it is by its own count, as the wall has it where that went round [s]; 0: none."""
        before, self._sequence = self._sequence, sequence
        step = 1 if before is None else (sequence - before) % SEQUENCES
        if before is not None and step:
            rounds = round(((now - self._came) * self.rate - step) / SEQUENCES)
            step += SEQUENCES * max(0, rounds)
        if step:
            self._messages, self._came = self._messages + step, now
        return step

    def _judge(self, status: int, temperature: float, now: float) -> None:
        ailments = list(self._condition.judge(float(temperature)))
        if status != VALID:
            text = f"it says of its sensors {status:#010b}; expected {VALID:#010b}, all of them well"
            ailments.append(Ailment(self.name, Fault.FAULTY, text))
        elif self.attitude is not None and now - self._oriented > GRACE:
            ailments.append(Ailment(self.name, Fault.FAULTY, "it finds its attitude anew; expected it to be at rest"))
        self.tell(ailments)


def _vector(values: list[float], unit: float) -> Vector:
    x, y, z = values
    return unit * x, unit * y, unit * z


def _is_sound(message: bytes) -> bool:
    """Whether its CRC is that of all that stands before."""
    crc = CRC_START
    for octet in message[:-CRC_SIZE]:
        crc = (crc << 8 & 0xFFFFFFFF) ^ _CRC[crc >> 24 ^ octet]
    return crc == int.from_bytes(message[-CRC_SIZE:], "big")


def _crc_table() -> tuple[int, ...]:
    table = []
    for octet in range(256):
        crc = octet << 24
        for _ in range(8):
            crc = crc << 1 ^ (CRC_POLYNOMIAL if crc & 0x80000000 else 0)
            crc &= 0xFFFFFFFF
        table.append(crc)
    return tuple(table)


_CRC = _crc_table()
