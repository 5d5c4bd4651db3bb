"""Frames on the CAN buses of the motor controllers and of the force/torque sensors; no maker publishes them: assumed.

Once a control period the master broadcasts SYNC; every unit samples then and answers with one STATE, which carries the
counter. Each motor controller then receives one COMMAND. REQUEST and REPLY serve identity and motor power. Numbers are
little-endian; every frame ends with the checksum over identifier and content; COMMAND and STATE are padded to 48 B.
The torque is the spring's, by its load cell; the current is the motor's::

    SYNC      0x080        counter u8, –                                                                     4 B
    COMMAND   0x100 + id   sequence u16, modes u8 × 2, axes × (position, velocity, effort, stiffness,
                           damping f32)                                                                     48 B (of 46)
    STATE     0x180 + id   of a motor controller: counter u8, status u8, command sequence u16, axes × (position,
                           velocity, torque, current f32), temperature i16 × 2 [0.1 °C], voltage u16
                           [0.01 V], its clock u32 [µs]                                                     48 B
                           of a sensor: counter u8, status u8, temperature i16 [0.1 °C], force f32 × 3,
                           torque f32 × 3                                                                   32 B
    REQUEST   0x200 + id   code u8, –                                                                        4 B
    REPLY     0x280 + id   code u8, result u8, serial 16 characters, firmware 8 characters                  32 B
"""

import struct
from binascii import crc_hqx
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import NamedTuple

import numpy as np

SYNC = 0x080
COMMAND = 0x100
STATE = 0x180
REQUEST = 0x200
REPLY = 0x280
UNIT = 0x07F
KIND = 0x780
AXES = 2
TO_MASTER = (STATE, REPLY)
TO_UNITS = (SYNC, COMMAND, REQUEST)

COMMAND_LENGTH = 48
CONTROLLER_STATE_LENGTH = 48
SENSOR_STATE_LENGTH = 32
REPLY_LENGTH = 32

COMMAND_TYPE = np.dtype(
    [
        ("sequence", "<u2"),
        ("mode", "u1", AXES),
        ("axis", [(name, "<f4") for name in ("position", "velocity", "effort", "stiffness", "damping")], AXES),
        ("filling", "u1", 2),
    ]
)
"""Content of a command, for vectors of commands."""

CONTROLLER_STATE = struct.Struct("<BBH8fhhHI")
SENSOR_STATE = struct.Struct("<BBh6f2x")
_SYNC = struct.Struct("<Bx")
_REQUEST = struct.Struct("<Bx")
_REPLY = struct.Struct("<BB16s8s4x")


CHECKSUM_SIZE = 2  # of the checksum [B]


def protect(identifier: int, content: bytes) -> bytes:
    """Data of a frame: its content, followed by the checksum."""
    return content + crc_hqx(content, identifier).to_bytes(CHECKSUM_SIZE, "little")


def is_valid(identifier: int, data: bytes | bytearray) -> bool:
    """Return whether the checksum of a frame is valid."""
    return crc_hqx(data[:-CHECKSUM_SIZE], identifier) == data[-2] | data[-1] << 8


class Status(IntFlag):
    """Status bits of every STATE."""

    ENABLED = 1  # motors are on
    CALIBRATED = 2  # joint positions checked since power-on
    WATCHDOG = 4  # command timeout: the unit holds its joints
    ENCODER_FAULT = 8
    OVER_TEMPERATURE = 16
    UNDER_VOLTAGE = 32
    INTERNAL_FAULT = 64


class Code(IntEnum):
    """Code of a REQUEST."""

    IDENTIFY = 1
    ENABLE = 2
    DISABLE = 3
    CALIBRATED = 4  # confirms that the joint positions have been checked


@dataclass(frozen=True)
class Identity:
    """Identity reported by a unit."""

    serial: str
    firmware: str


@dataclass(frozen=True)
class Reply:
    """Response to a request."""

    code: int
    done: bool
    identity: Identity


class Frame(NamedTuple):
    """A CAN FD frame."""

    identifier: int  # of 11 bits
    data: bytes


def sync(counter: int) -> Frame:
    """SYNC frame: all units sample."""
    return Frame(SYNC, protect(SYNC, _SYNC.pack(counter)))


def request(unit: int, code: Code) -> Frame:
    """REQUEST frame to one unit."""
    return Frame(REQUEST + unit, protect(REQUEST + unit, _REQUEST.pack(code)))


def reply(unit: int, code: int, done: bool, identity: Identity) -> Frame:
    """REPLY frame of a unit."""
    content = _REPLY.pack(code, not done, identity.serial.encode()[:16], identity.firmware.encode()[:8])
    return Frame(REPLY + unit, protect(REPLY + unit, content))


def read_reply(message: Frame) -> Reply | None:
    """Parse a REPLY; None if it is invalid."""
    if len(message.data) != REPLY_LENGTH or not is_valid(message.identifier, message.data):
        return None
    code, result, serial, firmware = _REPLY.unpack_from(message.data)
    return Reply(code, result == 0, Identity(_text(serial), _text(firmware)))


def read_small(message: Frame) -> int | None:
    """Counter of a SYNC or code of a REQUEST; None if it is invalid."""
    if len(message.data) != _SYNC.size + CHECKSUM_SIZE or not is_valid(message.identifier, message.data):
        return None
    return int(message.data[0])


def command_frames(units: Sequence[int], commands: np.ndarray[tuple[int], np.dtype[np.void]]) -> list[Frame]:
    """Encode a vector of ``COMMAND_TYPE``, one frame per unit."""
    raw, size = commands.tobytes(), COMMAND_TYPE.itemsize
    return [
        Frame(COMMAND + unit, protect(COMMAND + unit, raw[k * size : (k + 1) * size])) for k, unit in enumerate(units)
    ]


def is_command(message: Frame) -> bool:
    """Return whether a COMMAND is valid."""
    return len(message.data) == COMMAND_LENGTH and is_valid(message.identifier, message.data)


def read_commands(messages: Sequence[Frame]) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """Parse valid COMMANDs as a vector of ``COMMAND_TYPE``."""
    return np.frombuffer(b"".join(each.data[:-CHECKSUM_SIZE] for each in messages), dtype=COMMAND_TYPE)


def _text(raw: bytes) -> str:
    return raw.rstrip(b"\0").decode(errors="replace")
