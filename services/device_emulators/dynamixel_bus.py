"""Dynamixel servos on their bus: protocol 2.0, a control table each, and what the servo makes of it.

From the public e-manual, page "Protocol 2.0": the frames, the stuffing, CRC-16 (polynomial 0x8005, start 0),
instructions and errors. Assumed: that servos behind a silent one still answer a sync read::

    0xFF 0xFF 0xFD 0x00 │ id │ length │ instruction │ [error] parameters … │ CRC
            4           │ 1  │ 2, LE  │      1      │                      │ 2, LE

``length`` counts from the instruction to the CRC. Where 0xFF 0xFF 0xFD stands in instruction and parameters, 0xFD is
stuffed behind it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum

from valor.devices.dynamixel import (
    DEFAULT_SHUTDOWN,
    HardwareError,
    Item,
    OperatingMode,
    ServoModel,
)

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
MAX_LENGTH = 1024


class Instruction(IntEnum):
    """What a frame asks for."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


class Error(IntEnum):
    """Why a servo does not do it; bit 7 of a status says that ``hardware_error`` is not 0."""

    NONE = 0
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    ACCESS = 7
    ALERT = 0x80


class Servo:
    """One servo: its control table, written by the driver; its present values, written by what feels the joint.

    Attributes:
        temperature: of the motor [°C].
        voltage: of the supply [V].
    """

    def __init__(self, servo_id: int, model: ServoModel, firmware: int) -> None:
        self.id = servo_id
        self.model = model
        table = model.table
        self._registers = bytearray(table.size)
        self.set(table.model_number, model.number)
        self.set(table.firmware, firmware)
        self.set(table.id, servo_id)
        self.set(table.operating_mode, OperatingMode.POSITION)
        self.set(table.temperature_limit, model.temperature_limit)
        self.set(table.max_voltage, round(13.3 * model.voltage))
        self.set(table.min_voltage, round(7.9 * model.voltage))
        self.set(table.shutdown, int(DEFAULT_SHUTDOWN))
        self.temperature = 32.0
        self.voltage = model.voltage

    # --- the control table -------------------------------------------------------------------------------------------

    def get(self, item: Item) -> int:
        """A number of the control table."""
        return int.from_bytes(self._registers[item.address : item.address + item.size], "little", signed=item.signed)

    def set(self, item: Item, value: int) -> None:
        """Write a number as the servo's own firmware does, whatever the driver may write."""
        bits = 8 * item.size
        self._registers[item.address : item.address + item.size] = (value & ((1 << bits) - 1)).to_bytes(
            item.size, "little"
        )

    def read(self, address: int, size: int) -> bytes | None:
        """Bytes of the table; None if there are none at that place."""
        if size < 1 or address + size > len(self._registers):
            return None
        return bytes(self._registers[address : address + size])

    def write(self, address: int, data: bytes) -> Error:
        """Obey a write of the driver."""
        table = self.model.table
        writable = (table.torque_enable, table.goal_velocity, table.goal_position)
        persistent = (
            table.operating_mode,
            table.temperature_limit,
            table.shutdown,
            table.min_voltage,
            table.max_voltage,
        )
        for item in (*writable, *persistent):
            if (item.address, item.size) == (address, len(data)):
                break
        else:
            return Error.ACCESS
        if item in persistent and self.torque:
            return Error.ACCESS
        value = int.from_bytes(data, "little", signed=item.signed)
        if item == table.torque_enable:
            if value not in (0, 1):
                return Error.DATA_RANGE
            if value and self.get(table.hardware_error) & self.get(table.shutdown):
                return Error.ACCESS
            if value and not self.torque:  # a servo that is switched on stays where it is
                self.set(table.goal_position, self.get(table.present_position))
                self.set(table.goal_velocity, 0)
        if item == table.operating_mode and value not in tuple(OperatingMode):
            return Error.DATA_RANGE
        lowest, highest = self.model.goals
        if item == table.goal_position and self.mode == OperatingMode.POSITION and not lowest <= value <= highest:
            return Error.DATA_RANGE
        self.set(item, value)
        return Error.NONE

    def reboot(self) -> None:
        """Start anew: torque off, errors forgotten until they are found again."""
        table = self.model.table
        for item in (table.torque_enable, table.hardware_error, table.goal_velocity):
            self.set(item, 0)

    # --- the joint ---------------------------------------------------------------------------------------------------

    @property
    def torque(self) -> bool:
        """Whether the motor is on."""
        return bool(self.get(self.model.table.torque_enable))

    @property
    def mode(self) -> int:
        """OperatingMode."""
        return self.get(self.model.table.operating_mode)

    @property
    def goal_position(self) -> int:
        """[steps]."""
        return self.get(self.model.table.goal_position)

    @property
    def goal_velocity(self) -> float:
        """[rad/s]."""
        return self.get(self.model.table.goal_velocity) * self.model.velocity_unit

    def feel(self, position: float, velocity: float, torque: float, now: float) -> None:
        """Measure: steps from the encoder's own zero, [rad/s], [N·m], at ``now`` [s]; check temperature and voltage."""
        model, table = self.model, self.model.table
        self.set(table.realtime_tick, int(now * 1e3) % 32768)
        self.set(table.present_position, round(position))
        self.set(table.present_velocity, round(velocity / model.velocity_unit))
        self.set(table.present_current, round(torque / model.torque_constant / model.current_unit))
        self.set(table.present_voltage, round(10 * self.voltage))
        self.set(table.present_temperature, min(255, round(self.temperature)))
        wrong = HardwareError(0)
        if self.temperature >= self.get(table.temperature_limit):
            wrong |= HardwareError.OVERHEATING
        if not self.get(table.min_voltage) <= 10 * self.voltage <= self.get(table.max_voltage):
            wrong |= HardwareError.INPUT_VOLTAGE
        if wrong:
            self.set(table.hardware_error, self.get(table.hardware_error) | wrong)
            if wrong & self.get(table.shutdown):
                self.set(table.torque_enable, 0)

    @property
    def alert(self) -> int:
        """Error.ALERT if something is wrong with the hardware."""
        return int(Error.ALERT) if self.get(self.model.table.hardware_error) else 0


@dataclass(frozen=True)
class Status:
    """A frame that a servo answers with."""

    servo: int
    frame: bytes


class DynamixelBus:
    """Takes frames of a driver apart and lets the servos obey and answer.

    Attributes:
        servos: by id.
    """

    def __init__(self, servos: Sequence[Servo]) -> None:
        self.servos = {servo.id: servo for servo in servos}
        self._received = bytearray()

    def receive(self, data: bytes) -> list[Status]:
        """Take bytes in; returns the servos' answers in the order in which they come."""
        return [status for frame in self._frames(data) for status in self._obey(frame)]

    def _frames(self, data: bytes) -> Iterator[bytes]:
        """Sound frames from the id on, unstuffed, without the CRC."""
        received = self._received
        received += data
        while True:
            start = received.find(HEADER)
            if start < 0:
                del received[: max(0, len(received) - len(HEADER) + 1)]
                return
            del received[:start]
            if len(received) < 7:
                return
            length = int.from_bytes(received[5:7], "little")
            if not 3 <= length <= MAX_LENGTH:
                del received[0]
                continue
            end = 7 + length
            if len(received) < end:
                return
            frame = bytes(received[:end])
            if crc16(frame[:-2]) != int.from_bytes(frame[-2:], "little"):
                del received[0]
                continue
            del received[:end]
            yield frame[4:5] + unstuffed(frame[7:-2])

    def _obey(self, frame: bytes) -> list[Status]:
        target, instruction, parameters = frame[0], frame[1], frame[2:]
        if instruction == Instruction.STATUS:  # servos hear each other
            return []
        if target == BROADCAST:
            return self._obey_all(instruction, parameters)
        if (servo := self.servos.get(target)) is None:
            return []
        return [self._obey_one(servo, instruction, parameters)]

    def _obey_all(self, instruction: int, parameters: bytes) -> list[Status]:
        match instruction:
            case Instruction.PING:
                return [self._obey_one(servo, instruction, b"") for _, servo in sorted(self.servos.items())]
            case Instruction.SYNC_READ if len(parameters) > 4:
                return [
                    self._obey_one(self.servos[servo], Instruction.READ, parameters[:4])
                    for servo in parameters[4:]
                    if servo in self.servos
                ]
            case Instruction.SYNC_WRITE if len(parameters) > 4:
                size = int.from_bytes(parameters[2:4], "little")
                for place in range(4, len(parameters) - size, size + 1):
                    if servo := self.servos.get(parameters[place]):
                        servo.write(int.from_bytes(parameters[:2], "little"), parameters[place + 1 : place + 1 + size])
        return []

    def _obey_one(self, servo: Servo, instruction: int, parameters: bytes) -> Status:
        answer, error = b"", Error.NONE
        match instruction:
            case Instruction.PING:
                table = servo.model.table
                answer = servo.get(table.model_number).to_bytes(2, "little") + bytes((servo.get(table.firmware),))
            case Instruction.READ if len(parameters) == 4:
                data = servo.read(*(int.from_bytes(parameters[i : i + 2], "little") for i in (0, 2)))
                answer, error = (b"", Error.DATA_RANGE) if data is None else (data, Error.NONE)
            case Instruction.WRITE if len(parameters) > 2:
                error = servo.write(int.from_bytes(parameters[:2], "little"), parameters[2:])
            case Instruction.REBOOT:
                servo.reboot()
            case Instruction.READ | Instruction.WRITE:
                error = Error.DATA_LENGTH
            case _:
                error = Error.INSTRUCTION
        return Status(servo.id, encode(servo.id, Instruction.STATUS, bytes((error | servo.alert,)) + answer))


def encode(servo: int, instruction: int, parameters: bytes) -> bytes:
    """A frame's bytes."""
    body = stuffed(bytes((instruction,)) + parameters)
    frame = HEADER + bytes((servo,)) + (len(body) + 2).to_bytes(2, "little") + body
    return frame + crc16(frame).to_bytes(2, "little")


def stuffed(body: bytes) -> bytes:
    """Instruction and parameters as they go over the line."""
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def unstuffed(body: bytes) -> bytes:
    """The reverse of ``stuffed``."""
    return body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


def crc16(data: bytes) -> int:
    """CRC-16 of polynomial 0x8005, most significant bit first, start 0."""
    crc = 0
    for octet in data:
        crc = (crc << 8 & 0xFFFF) ^ _CRC_TABLE[crc >> 8 ^ octet]
    return crc


def _crc_table() -> tuple[int, ...]:
    table = []
    for octet in range(256):
        crc = octet << 8
        for _ in range(8):
            crc = crc << 1 ^ (0x8005 if crc & 0x8000 else 0)
            crc &= 0xFFFF
        table.append(crc)
    return tuple(table)


_CRC_TABLE = _crc_table()
