"""KVH 1750 inertial measurement unit on a serial port; the driver computes its attitude.

Assumed mounting: parallel to the robot's IMU frame, x axis forward, z axis up; its heading starts at 0.
"""

import math
import re
import time
import zlib

import numpy as np

from valor.common.rotation import IDENTITY, Quaternion, Vector, multiply, unit, vertical
from valor.comms_manager.hardware.condition import Condition, Limits, require_identity
from valor.comms_manager.hardware.device import DeviceContext, DeviceError, Fault, ImuMeasurement, UnitFault
from valor.comms_manager.hardware.serial_sensor import ANSWER_TIME, NoAnswerError, SerialSensor
from valor.devices.frame_stream import FrameStream
from valor.devices.kvh import CRC_SIZE, HEADER, MESSAGE, SEQUENCES, STANDARD_GRAVITY, VALID, WARMEST, Kvh1750

FASTEST, STRONGEST = 20.0, 200.0  # above its range of 490 °/s and 10 g [rad/s, m/s²]
WARM = 5.0  # below its temperature limit [K]
GRACE = 0.15  # duration without an attitude that is not reported [s]
_ATTITUDE_WITHIN = 5.0  # timeout of the first attitude at start, at rest [s]
GRAVITY = 9.80665  # [m/s²]
TIME_CONSTANT = 10.0  # 1/k_P: time in which a tilt error decreases by a factor of e [s]
# Time at rest before the first attitude; a walking robot never rests as long [s].
ALIGNMENT = 0.5
LONGEST_GAP = 0.05  # largest time between samples that is integrated [s]
REST_RATE = 0.1  # upper bound of the rate at rest [rad/s]
STEADY, REST_FORCE = 0.3, 0.5  # at rest: deviations of the specific force from its mean, and of the mean from g [m/s²]
AGREEMENT = 0.03  # tilt error by gravity below which the attitude is kept after a gap [rad]


class AttitudeFilter:
    """Attitude of a sensor in a world with z up; its heading starts at 0.

    A complementary filter on SO(3) after Mahony, Hamel and Pflimlin ("Nonlinear Complementary Filters on the Special
    Orthogonal Group", IEEE TAC 2008, the passive filter without bias), with the accelerometer as the only reference::

        q' = ½ q ⊗ (ω + k_P · a/|a| × R(q)ᵀ e_z)

    Accelerations of the robot average out over 1/k_P; the heading depends on the gyroscopes only.
    """

    def __init__(self) -> None:
        self.orientation: Quaternion | None = None  # w, x, y, z; None until the sensor has been at rest
        self._rested = 0.0  # [s]
        self._samples = 0
        self._mean: Vector = (0.0, 0.0, 0.0)  # of the specific force at rest [m/s²]

    def reset(self) -> None:
        """Restart the alignment, after unknown motion."""
        self.__init__()  # type: ignore[misc]

    def update(self, rate: Vector, force: Vector, elapsed: float) -> None:
        """Process rate [rad/s] and specific force [m/s²], ``elapsed`` [s] after the last by the sensor's own clock."""
        if elapsed > LONGEST_GAP and not self._agrees(rate, force):
            self.reset()
        elif self.orientation is None:
            self._align(rate, force, elapsed)
        elif elapsed <= LONGEST_GAP:
            self.orientation = _turned(self.orientation, rate, force, elapsed)

    def _agrees(self, rate: Vector, force: Vector) -> bool:
        """Return whether the sensor is at rest, with unchanged tilt."""
        if self.orientation is None or math.hypot(*rate) > REST_RATE:
            return False
        ux, uy, uz = vertical(self.orientation)
        fx, fy, fz = force
        across = math.hypot(fy * uz - fz * uy, fz * ux - fx * uz, fx * uy - fy * ux)
        return math.atan2(across, fx * ux + fy * uy + fz * uz) < AGREEMENT

    def _align(self, rate: Vector, force: Vector, elapsed: float) -> None:
        """Set the tilt such that the mean specific force at rest points up."""
        steady = self._samples == 0 or math.dist(force, self._mean) < STEADY
        if math.hypot(*rate) > REST_RATE or not steady:
            self.reset()
            return
        self._samples += 1
        x, y, z = (mean + (each - mean) / self._samples for mean, each in zip(self._mean, force, strict=True))
        self._mean = x, y, z
        self._rested += elapsed
        if self._rested >= ALIGNMENT and abs(math.hypot(x, y, z) - GRAVITY) < REST_FORCE:
            self.orientation = _about_horizontal(math.atan2(y, z), math.atan2(-x, math.hypot(y, z)))


class Kvh(SerialSensor):
    """One sensor on a dedicated port."""

    first_sample = _ATTITUDE_WITHIN

    def __init__(self, name: str, context: DeviceContext) -> None:
        table = context.robot.tables.devices[name]
        assert isinstance(table, Kvh1750)
        stream = FrameStream(HEADER, len(HEADER), lambda _: MESSAGE.size + CRC_SIZE, _is_valid)
        super().__init__(name, context, table.rate, table.baud_rate, stream)
        self._table = table
        self._filter = AttitudeFilter()
        self._condition = Condition(self._record, Limits(WARMEST - WARM, WARMEST, -math.inf))
        self._messages = 0  # number by its own count, since ``find``
        self._sequence: int | None = None
        self._came = 0.0  # time of the latest message [monotonic s]
        self._oriented = 0.0  # time of the latest attitude [monotonic s]

    def _wanted(self) -> str:
        return f"a KVH 1750 with serial number {self._table.serial} on {self._path}, at rest"

    def _begin(self, tries: int) -> None:
        self._request("=CONFIG,1", tries)
        require_identity(self.name, self._table, serial=self._request("?IS", tries))
        for command in ("=ROTFMT,RATE", "=ROTUNITS,RAD", "=TEMPUNITS,C", f"=DR,{self._table.rate}"):
            self._request(command, tries)
        assert self._port is not None
        self._port.write(b"=CONFIG,0\n")  # has no response
        self._filter.reset()

    @property
    def _is_known(self) -> bool:
        return self.attitude is not None

    @property
    def _farewell(self) -> bytes:
        return b"=CONFIG,1\n"

    def _request(self, command: str, tries: int) -> str:
        assert self._port is not None
        keyword = command[1:].partition(",")[0]
        answer = re.compile(rb"(INVALID|" + keyword.encode() + rb"),([^\r\n]*)[\r\n]")
        for _ in range(tries):
            self._port.write(command.encode() + b"\n")
            deadline, received = time.monotonic() + ANSWER_TIME, b""
            while (remaining := deadline - time.monotonic()) > 0.0:
                received += self._read(remaining)
                if (found := answer.search(received)) is None:
                    continue
                value = found[2].decode("ascii", "replace").strip()
                if found[1] == b"INVALID" or (command[0] == "=" and value != command.partition(",")[2]):
                    raise DeviceError(f"{self.name}: response to {command} is {value!r}; expected {self._wanted()}")
                return value
        raise NoAnswerError(f"{self.name}: no answer within {tries * ANSWER_TIME:g} s; expected {self._wanted()}")

    def _take(self, frame: bytes) -> bool:
        stamp = time.monotonic_ns()
        _, *values, status, sequence, temperature = MESSAGE.unpack_from(frame)
        rate, force = _vector(values[:3], 1.0), _vector(values[3:], STANDARD_GRAVITY)
        self._judge(status, temperature, 1e-9 * stamp)
        if status != VALID or not (math.hypot(*rate) < FASTEST and math.hypot(*force) < STRONGEST):
            return False
        passed = self._passed(sequence, 1e-9 * stamp)
        late = self._lateness(self._messages / self.rate, stamp)
        if not passed:
            return False
        self._filter.update(rate, force, passed / self.rate)  # late ones too, as the motion happened
        if late is None:
            return False
        self._record.received(stamp)
        self._record.answered(late)
        orientation = self._filter.orientation
        self.inertia = ImuMeasurement(stamp, np.array(orientation or IDENTITY), np.array(rate), np.array(force))
        if orientation is not None:
            self._oriented = self._came
            self.attitude = self.inertia
        return True

    def _passed(self, sequence: int, now: float) -> int:
        """Number of messages since the last, by its count and, for full rounds, the time ``now`` [s]; 0: repeated."""
        before, self._sequence = self._sequence, sequence
        step = 1 if before is None else (sequence - before) % SEQUENCES
        if before is not None and step:
            rounds = round(((now - self._came) * self.rate - step) / SEQUENCES)
            step += SEQUENCES * max(0, rounds)
        if step:
            self._messages, self._came = self._messages + step, now
        return step

    def _judge(self, status: int, temperature: float, now: float) -> None:
        unit_faults = list(self._condition.judge(float(temperature)))
        if status != VALID:
            text = f"status {status:#010b}; expected {VALID:#010b}, all sensors valid"
            unit_faults.append(UnitFault(self.name, Fault.FAULTY, text))
        elif self.attitude is not None and now - self._oriented > GRACE:
            unit_faults.append(
                UnitFault(self.name, Fault.FAULTY, "it aligns its attitude again; expected it to be at rest")
            )
        self.report_faults(unit_faults)


def _vector(values: list[float], unit: float) -> Vector:
    x, y, z = values
    return unit * x, unit * y, unit * z


def _is_valid(message: bytes) -> bool:
    """Return whether the CRC of a message is correct.

    The sensor's CRC (CRC-32/MPEG-2) has the polynomial of ``zlib.crc32`` in the other order of bits, and ends with 0.
    """
    return zlib.crc32(message.translate(_REVERSED)) == 0xFFFFFFFF


_REVERSED = bytes(int(f"{octet:08b}"[::-1], 2) for octet in range(256))


def _about_horizontal(roll: float, pitch: float) -> Quaternion:
    """Rotation by pitch, then by roll about the new x axis [rad]."""
    y = (math.cos(0.5 * pitch), 0.0, math.sin(0.5 * pitch), 0.0)
    return multiply(y, (math.cos(0.5 * roll), math.sin(0.5 * roll), 0.0, 0.0))


def _turned(q: Quaternion, rate: Vector, force: Vector, elapsed: float) -> Quaternion:
    """Integrate the rate over ``elapsed`` [s], with the correction toward the specific force."""
    ux, uy, uz = vertical(q)
    fx, fy, fz = force
    gain = 1.0 / (TIME_CONSTANT * max(math.hypot(fx, fy, fz), 0.1 * GRAVITY))
    turn = (
        elapsed * (rate[0] + gain * (fy * uz - fz * uy)),
        elapsed * (rate[1] + gain * (fz * ux - fx * uz)),
        elapsed * (rate[2] + gain * (fx * uy - fy * ux)),
    )
    angle = math.hypot(*turn)
    share = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    return unit(multiply(q, (math.cos(0.5 * angle), share * turn[0], share * turn[1], share * turn[2])))
