"""Frames on the HDT modules' CAN FD bus, between the vendor's driver and the modules. The layout is assumed.

Up to four neighboring modules share a *segment*: a gateway on the bus with a number of its own. Limbs take their
segments' numbers one limb after another. One command and one state frame a segment and cycle, little-endian::

    0x080 + segment  command   sequence u16, flags u16
                               4 × (position i32 [µrad], velocity i16 [mrad/s], effort i16 [0.01 N·m],
                                    stiffness u16 [0.1 N·m/rad], damping u16 [0.01 N·m·s/rad], mode u8, 0 u8)
    0x100 + segment  state     command sequence u16, state sequence u16, voltage u16 [10 mV], 0 u16
                               4 × (position i32 [µrad], velocity i16 [mrad/s], effort i16 [0.01 N·m],
                                    temperature i8 [°C], fault u8)
    0x180 + segment  inquiry   empty
    0x200 + segment  identity  serial number, NUL, firmware, NUL; ASCII

A command without ``SETPOINTS`` in its flags only asks for a state. ``command sequence`` is that of the newest frame
with set-points that the segment obeys. Without set-points for ``WATCHDOG`` modules keep to the last, at rest; those
that were told nothing yet since they were switched on hold where they are, by their own servo.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import Any

import can
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray

JOINTS = 4  # of a segment, at most
COMMAND, STATE, INQUIRY, IDENTITY = 0x080, 0x100, 0x180, 0x200  # first identifiers of each kind
KIND = 0x7C0  # of an identifier, the bits that are the kind
SEGMENTS = 64  # on a bus, at most
SETPOINTS = 1  # flag of a command
WATCHDOG = 0.25  # [s]

_SEGMENT = 0x03F
_COMMAND_HEADER = struct.Struct("<HH")
_COMMAND_SIZE, _STATE_SIZE = 64, 48  # lengths that CAN FD has, from 60 and 48 bytes
_VOLT = 0.01
# What a number of each kind is in SI units; of temperatures, faults and modes it is itself.
_SETPOINT_UNITS = np.array([1e-6, 1e-3, 0.01, 0.1, 0.01, 1.0])[:, np.newaxis]
_MEASURED_UNITS = np.array([1e-6, 1e-3, 0.01, 1.0, 1.0])[:, np.newaxis]
_SETPOINT, _MEASURED = "ihhHHBx", "ihhbB"  # a joint's, as ``struct`` has them


@functools.cache
def _setpoint_layout(joints: int) -> struct.Struct:
    return struct.Struct("<HH" + joints * _SETPOINT)


@functools.cache
def _measured_layout(joints: int) -> struct.Struct:
    return struct.Struct("<HHHH" + joints * _MEASURED)


def _columns(layout: str, units: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of each kind of number in a joint's layout, (m, 1) each: how many a unit is, the least, the most."""
    limits = [np.iinfo(np.dtype(kind)) for kind in layout.removesuffix("x")]
    least, most = (
        np.array(bounds, dtype=np.float64)[:, np.newaxis]
        for bounds in zip(*((each.min, each.max) for each in limits), strict=True)
    )
    return 1.0 / units, least, most


_SETPOINT_COLUMNS, _MEASURED_COLUMNS = _columns(_SETPOINT, _SETPOINT_UNITS), _columns(_MEASURED, _MEASURED_UNITS)


class Fault(IntFlag):
    """What a module says is wrong with it (``HdtState.fault``); NO_ANSWER is what its driver says of it."""

    OVER_TEMPERATURE = 1
    UNDER_VOLTAGE = 2
    ENCODER = 4
    NO_ANSWER = 8


class FrameError(ValueError):
    """A frame that is not what its identifier says."""


def segments(joints: int) -> list[slice]:
    """Which of a limb's joints each of its segments has."""
    return [slice(first, min(first + JOINTS, joints)) for first in range(0, joints, JOINTS)]


def kind_and_segment(identifier: int) -> tuple[int, int]:
    """What a frame is, and the segment that it is of or for."""
    return identifier & KIND, identifier & _SEGMENT


@dataclass(frozen=True)
class Setpoints:
    """What the joints of a segment shall do; (k,) each.

    Attributes:
        mode: off, position, impedance, force: 0 to 3, as in ``HdtCommand``.
        position: [rad].
        velocity: [rad/s].
        effort: [N·m].
        stiffness: [N·m/rad].
        damping: [N·m·s/rad].
    """

    mode: npt.NDArray[np.uint8]
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray
    stiffness: FloatArray
    damping: FloatArray

    def of(self, part: slice) -> Setpoints:
        """Those of some of the joints."""
        return Setpoints(
            self.mode[part],
            self.position[part],
            self.velocity[part],
            self.effort[part],
            self.stiffness[part],
            self.damping[part],
        )


@dataclass(frozen=True)
class SegmentState:
    """What a segment answers; (k,) each.

    Attributes:
        command_sequence: of the newest frame with set-points that it obeys; 0: none yet.
        sequence: its own count of states.
        voltage: of its supply [V].
        position: [rad].
        velocity: [rad/s].
        effort: [N·m].
        temperature: [°C].
        fault: ``Fault`` bits.
    """

    command_sequence: int
    sequence: int
    voltage: float
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray
    temperature: FloatArray
    fault: npt.NDArray[np.uint8]


def command(segment: int, sequence: int, setpoints: Setpoints | None) -> can.Message:
    """A command frame; numbers beyond what it can carry are brought to the nearest that it can.

    Args:
        segment: whom it is for.
        sequence: of the command, 1 to 65535.
        setpoints: None: nothing but a state is asked for.
    """
    return commands([(segment, slice(None))], sequence, setpoints)[0]


def commands(whom: Iterable[tuple[int, slice]], sequence: int, setpoints: Setpoints | None) -> list[can.Message]:
    """As ``command``, for some segments of a limb, whose set-points are brought to numbers all at once.

    Args:
        whom: segments, and which of the limb's joints each has.
        sequence: of all of them.
        setpoints: of the limb.
    """
    if setpoints is None:
        plain = _COMMAND_HEADER.pack(sequence, 0).ljust(_COMMAND_SIZE, b"\0")
        return [_frame(COMMAND + segment, bytearray(plain)) for segment, _ in whom]
    to = setpoints
    numbers = _numbers((to.position, to.velocity, to.effort, to.stiffness, to.damping, to.mode), _SETPOINT_COLUMNS)
    frames = []
    for segment, part in whom:
        data, joints = bytearray(_COMMAND_SIZE), numbers[part]
        values = [number for joint in joints for number in joint]
        _setpoint_layout(len(joints)).pack_into(data, 0, sequence, SETPOINTS, *values)
        frames.append(_frame(COMMAND + segment, data))
    return frames


def parse_command(frame: can.Message, joints: int) -> tuple[int, Setpoints | None]:
    """Sequence and set-points of a command frame, if it carries any.

    Raises:
        FrameError: it is too short.
    """
    _require(frame, _COMMAND_SIZE)
    sequence, flags, *numbers = _setpoint_layout(joints).unpack_from(frame.data)
    if not flags & SETPOINTS:
        return sequence, None
    table = np.array(numbers, dtype=np.float64).reshape(joints, len(_SETPOINT_UNITS)).T * _SETPOINT_UNITS
    position, velocity, effort, stiffness, damping, mode = table
    return sequence, Setpoints(mode.astype(np.uint8), position, velocity, effort, stiffness, damping)


def state(segment: int, measured: SegmentState) -> can.Message:
    """A state frame."""
    data = bytearray(_STATE_SIZE)
    volts = min(0xFFFF, max(0, round(measured.voltage / _VOLT)))
    columns = measured.position, measured.velocity, measured.effort, measured.temperature, measured.fault
    values = [number for joint in _numbers(columns, _MEASURED_COLUMNS) for number in joint]
    _measured_layout(measured.position.size).pack_into(
        data, 0, measured.command_sequence, measured.sequence, volts, 0, *values
    )
    return _frame(STATE + segment, data)


def parse_state(frame: can.Message, joints: int) -> SegmentState:
    """What a state frame says.

    Raises:
        FrameError: it is too short.
    """
    _require(frame, _STATE_SIZE)
    command_sequence, sequence, volts, _, *numbers = _measured_layout(joints).unpack_from(frame.data)
    table = np.array(numbers, dtype=np.float64).reshape(joints, len(_MEASURED_UNITS)).T * _MEASURED_UNITS
    position, velocity, effort, temperature, fault = table
    return SegmentState(
        command_sequence,
        sequence,
        volts * _VOLT,
        position=position,
        velocity=velocity,
        effort=effort,
        temperature=temperature,
        fault=fault.astype(np.uint8),
    )


def inquiry(segment: int) -> can.Message:
    """Who are you?"""
    return _frame(INQUIRY + segment, bytearray())


def identity(segment: int, serial: str, firmware: str) -> can.Message:
    """The answer; 64 bytes at most."""
    data = f"{serial}\0{firmware}\0".encode("ascii")
    return _frame(IDENTITY + segment, bytearray(data.ljust(64, b"\0")))


def parse_identity(frame: can.Message) -> tuple[str, str]:
    """Serial number and firmware.

    Raises:
        FrameError: it is neither.
    """
    try:
        serial, firmware, *_ = bytes(frame.data).decode("ascii").split("\0")
    except ValueError:
        raise FrameError(f"identity of segment {frame.arbitration_id & _SEGMENT}: not two texts") from None
    return serial, firmware


def _frame(identifier: int, data: bytearray) -> can.Message:
    return can.Message(
        arbitration_id=identifier, data=data, is_extended_id=False, is_fd=True, bitrate_switch=True, check=False
    )


def _require(frame: can.Message, size: int) -> None:
    if len(frame.data) < size:
        raise FrameError(f"frame {frame.arbitration_id:#05x}: {len(frame.data)} bytes, expected {size}")


def _numbers(values: Sequence[npt.NDArray[Any]], columns: tuple[FloatArray, FloatArray, FloatArray]) -> list[list[int]]:
    """Scale, round and clamp values, all at once: this is done for every frame. A joint's numbers after another's."""
    scale, least, most = columns
    numbers = np.array(values, dtype=np.float64)
    numbers *= scale
    np.rint(numbers, out=numbers)
    np.maximum(numbers, least, out=numbers)
    np.minimum(numbers, most, out=numbers)
    found: list[list[int]] = numbers.T.astype(np.int64).tolist()
    return found
