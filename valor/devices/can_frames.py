"""Frames on the CAN buses of the motor controllers and of the force/torque sensors.

Once a control period the master broadcasts SYNC with a counter; every unit samples at that instant and answers with
one STATE that carries the counter. Motor controllers then get one COMMAND each. Who a unit is, and switching motors,
goes by REQUEST and REPLY. Numbers are little-endian; every frame ends with the checksum of ``end_to_end``.

::

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

CAN FD knows no lengths between 32 and 48 bytes but those two: frames are filled up with zeros before the checksum.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag

import can
import numpy as np

from valor.devices.end_to_end import SIZE, is_sound, protect

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
"""A command's content, for whole vectors of them."""

CONTROLLER_STATE = struct.Struct("<BBH8fhhHI")
SENSOR_STATE = struct.Struct("<BBh6f2x")
_SYNC = struct.Struct("<Bx")
_REQUEST = struct.Struct("<Bx")
_REPLY = struct.Struct("<BB16s8s4x")


class Status(IntFlag):
    """What a unit says of itself in every STATE."""

    ENABLED = 1  # motors are on
    CALIBRATED = 2  # since it got power, its joints' places have been checked
    WATCHDOG = 4  # no command has come for too long: it holds its joints
    ENCODER_FAULT = 8
    OVER_TEMPERATURE = 16
    UNDER_VOLTAGE = 32
    INTERNAL_FAULT = 64


class Code(IntEnum):
    """What a REQUEST asks for."""

    IDENTIFY = 1
    ENABLE = 2
    DISABLE = 3
    CALIBRATED = 4  # take note that the joints' places have been checked


@dataclass(frozen=True)
class Identity:
    """Who a unit says it is."""

    serial: str
    firmware: str


@dataclass(frozen=True)
class Reply:
    """Answer to a request."""

    code: int
    done: bool
    identity: Identity


def frame(identifier: int, data: bytes) -> can.Message:
    """A CAN FD frame with an 11-bit identifier."""
    return can.Message(
        arbitration_id=identifier, data=data, is_extended_id=False, is_fd=len(data) > 8, bitrate_switch=len(data) > 8
    )


def sync(counter: int) -> can.Message:
    """Everybody sample now."""
    return frame(SYNC, protect(SYNC, _SYNC.pack(counter)))


def request(unit: int, code: Code) -> can.Message:
    """Ask one unit for something."""
    return frame(REQUEST + unit, protect(REQUEST + unit, _REQUEST.pack(code)))


def reply(unit: int, code: int, done: bool, identity: Identity) -> can.Message:
    """A unit's answer."""
    content = _REPLY.pack(code, not done, identity.serial.encode()[:16], identity.firmware.encode()[:8])
    return frame(REPLY + unit, protect(REPLY + unit, content))


def read_reply(message: can.Message) -> Reply | None:
    """The answer that a frame is; None: it is none that can be believed."""
    if len(message.data) != REPLY_LENGTH or not is_sound(message.arbitration_id, message.data):
        return None
    code, result, serial, firmware = _REPLY.unpack_from(message.data)
    return Reply(code, result == 0, Identity(_text(serial), _text(firmware)))


def read_small(message: can.Message) -> int | None:
    """A SYNC's counter or a REQUEST's code; None: it cannot be believed."""
    if len(message.data) != _SYNC.size + SIZE or not is_sound(message.arbitration_id, message.data):
        return None
    return int(message.data[0])


def command_frames(units: Sequence[int], commands: np.ndarray[tuple[int], np.dtype[np.void]]) -> list[can.Message]:
    """A vector of ``COMMAND_TYPE`` as frames, one a unit."""
    raw, size = commands.tobytes(), COMMAND_TYPE.itemsize
    return [
        frame(COMMAND + unit, protect(COMMAND + unit, raw[k * size : (k + 1) * size])) for k, unit in enumerate(units)
    ]


def read_command(message: can.Message) -> np.void | None:
    """The ``COMMAND_TYPE`` in a frame; None: it cannot be believed."""
    if len(message.data) != COMMAND_LENGTH or not is_sound(message.arbitration_id, message.data):
        return None
    command: np.void = np.frombuffer(message.data, dtype=COMMAND_TYPE, count=1)[0]
    return command


def _text(raw: bytes) -> str:
    return raw.rstrip(b"\0").decode(errors="replace")
