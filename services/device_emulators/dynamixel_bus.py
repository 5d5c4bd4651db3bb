"""Dynamixel servos on their bus: protocol 2.0, a control table each, and what the servo makes of it.

From the public e-manual, page "Protocol 2.0": the frames, the stuffing, CRC-16 (polynomial 0x8005, start 0),
instructions and errors. Assumed: that servos behind a silent one still answer a sync read::

    0xFF 0xFF 0xFD 0x00 │ id │ length │ instruction │ [error] parameters … │ CRC
            4           │ 1  │ 2, LE  │      1      │                      │ 2, LE

``length`` counts from the instruction to the CRC. Where 0xFF 0xFF 0xFD stands in instruction and parameters, 0xFD is
stuffed behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from valor.device_emulators.dynamixel_servo import Error, Servo
from valor.devices.frame_stream import FrameStream

HEADER = b"\xff\xff\xfd\x00"
PREFIX = 7  # up to the length, which counts from there [B]
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
        self._frames = FrameStream(HEADER, PREFIX, _size, _is_sound)

    def receive(self, data: bytes) -> list[Status]:
        """Take bytes in; returns the servos' answers in the order in which they come."""
        return [
            status
            for frame in self._frames.feed(data)
            for status in self._obey(frame[4:5] + unstuffed(frame[PREFIX:-2]))
        ]

    def _obey(self, frame: bytes) -> list[Status]:
        """``frame``: from the id on, unstuffed, without length and CRC."""
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


def _size(prefix: bytearray) -> int:
    length = int.from_bytes(prefix[5:PREFIX], "little")
    return PREFIX + length if 3 <= length <= MAX_LENGTH else 0


def _is_sound(frame: bytes) -> bool:
    return crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")


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
