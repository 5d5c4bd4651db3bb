"""MicroStrain's packet protocol (MIP), as far as a 3DM-GX4-25 is used here: numbers and field layouts.

Only the tables stand here. The driver (``valor.comms_manager.hardware.mip``) and the emulator
(``valor.device_emulators.mip_sensor``) each frame, check and take packets apart by themselves, so that one mistake is
not made twice. All numbers are big-endian::

    0x75 0x65 │ descriptor set │ payload length │ fields … │ checksum
        2     │       1        │       1        │          │    2

    field:  length, with this byte and the next │ descriptor │ data …

The checksum is Fletcher's over everything before it: the running sum of the bytes, then the running sum of that, each
modulo 256.

From the public manual of the vendor ("3DM-GX4-25 Data Communications Protocol"): everything in this module, but for
``IMU_BASE_RATE`` and ``FILTER_BASE_RATE``, which are those of its data sheet and which a driver asks the device for.
"""

from __future__ import annotations

from enum import IntEnum
from struct import Struct
from typing import Annotated

from msgspec import Meta

from valor.common.table import Positive
from valor.devices.table import Device

SYNC = b"\x75\x65"
HEADER_SIZE = 4
CHECKSUM_SIZE = 2
MAX_PAYLOAD = 255

STANDARD_GRAVITY = 9.80665  # the unit of ScaledAccelerometer [m/s²]
IMU_BASE_RATE = 1000  # [Hz]
FILTER_BASE_RATE = 500  # [Hz]


class DescriptorSet(IntEnum):
    """What a packet is about; a reply's is that of its command."""

    BASE = 0x01
    THREE_DM = 0x0C
    IMU_DATA = 0x80
    FILTER_DATA = 0x82


class Base(IntEnum):
    """Commands of ``DescriptorSet.BASE``."""

    PING = 0x01
    SET_TO_IDLE = 0x02  # streams stop until RESUME
    DEVICE_INFORMATION = 0x03
    RESUME = 0x06
    RESET = 0x7E


class ThreeDm(IntEnum):
    """Commands of ``DescriptorSet.THREE_DM``."""

    IMU_BASE_RATE = 0x06
    IMU_MESSAGE_FORMAT = 0x08
    FILTER_MESSAGE_FORMAT = 0x0A
    FILTER_BASE_RATE = 0x0B
    ENABLE_STREAM = 0x11


class Reply(IntEnum):
    """Fields of replies."""

    ACKNOWLEDGE = 0xF1
    DEVICE_INFORMATION = 0x81
    IMU_MESSAGE_FORMAT = 0x80
    FILTER_MESSAGE_FORMAT = 0x82
    IMU_BASE_RATE = 0x83
    STREAM_ENABLED = 0x85
    FILTER_BASE_RATE = 0x8A


class Result(IntEnum):
    """Second byte of ``Reply.ACKNOWLEDGE``, after the command's descriptor."""

    OK = 0x00
    UNKNOWN_COMMAND = 0x01
    INVALID_CHECKSUM = 0x02
    INVALID_PARAMETER = 0x03
    COMMAND_FAILED = 0x04
    COMMAND_TIMEOUT = 0x05


class Function(IntEnum):
    """First byte of the commands that set something."""

    APPLY = 0x01
    READ = 0x02


class Stream(IntEnum):
    """Device selector of ``ThreeDm.ENABLE_STREAM``."""

    IMU = 0x01
    FILTER = 0x03


class ImuData(IntEnum):
    """Fields of ``DescriptorSet.IMU_DATA``."""

    SCALED_ACCELEROMETER = 0x04  # specific force [g]
    SCALED_GYROSCOPE = 0x05  # [rad/s]
    ORIENTATION_MATRIX = 0x09  # row after row: vector in sensor = M · vector in north-east-down
    QUATERNION = 0x0A  # w, x, y, z: of the sensor in north-east-down
    GPS_TIMESTAMP = 0x12


class FilterData(IntEnum):
    """Fields of ``DescriptorSet.FILTER_DATA``; all but the status end with a valid flag."""

    ATTITUDE_QUATERNION = 0x03  # w, x, y, z: of the sensor in north-east-down
    ATTITUDE_MATRIX = 0x04  # as ImuData.ORIENTATION_MATRIX
    COMPENSATED_ANGULAR_RATE = 0x0E  # [rad/s]
    STATUS = 0x10
    GPS_TIMESTAMP = 0x11
    COMPENSATED_ACCELERATION = 0x1C  # specific force, gravity in it [m/s²]


class FilterState(IntEnum):
    """First number of ``FilterData.STATUS``."""

    STARTUP = 0x00
    INITIALIZATION = 0x01
    RUNNING_VALID = 0x02
    RUNNING_ERROR = 0x03


DATA_FIELDS: dict[DescriptorSet, dict[int, Struct]] = {
    DescriptorSet.IMU_DATA: {
        ImuData.SCALED_ACCELEROMETER: Struct(">3f"),
        ImuData.SCALED_GYROSCOPE: Struct(">3f"),
        ImuData.ORIENTATION_MATRIX: Struct(">9f"),
        ImuData.QUATERNION: Struct(">4f"),
        ImuData.GPS_TIMESTAMP: Struct(">dHH"),  # time of week [s], week, flags
    },
    DescriptorSet.FILTER_DATA: {
        FilterData.ATTITUDE_QUATERNION: Struct(">4fH"),
        FilterData.ATTITUDE_MATRIX: Struct(">9fH"),
        FilterData.COMPENSATED_ANGULAR_RATE: Struct(">3fH"),
        FilterData.STATUS: Struct(">HHH"),  # FilterState, dynamics mode, flags
        FilterData.GPS_TIMESTAMP: Struct(">dHH"),
        FilterData.COMPENSATED_ACCELERATION: Struct(">3fH"),
    },
}

DEVICE_INFORMATION = Struct(">H16s16s16s16s16s")
"""Firmware (1126: 1.1.26), model name, model number, serial number, lot number, options; padded with blanks."""

FORMAT_ENTRY = Struct(">BH")
"""Of a message format: descriptor, decimation of the base rate."""


class MicroStrainMip(Device, tag="microstrain_mip"):
    """An inertial measurement unit that speaks MIP on a serial port."""

    model: str
    serial: str
    firmware: str
    rate: Positive  # of its data packets [Hz]
    baud_rate: Annotated[int, Meta(gt=0)] = 921600

    @property
    def joints(self) -> list[str]:
        """None."""
        return []
