"""MicroStrain's packet protocol (MIP): the numbers and layouts that a 3DM-GX4-25 is used with.

Driver (``valor.comms_manager.hardware.microstrain``) and emulator (``valor.device_emulators.microstrain``) implement
these tables independently, so that tests find mistakes. All numbers are big-endian::

    0x75 0x65 │ descriptor set │ payload length │ fields … │ checksum
        2     │       1        │       1        │          │    2

    field:  length, with this byte and the next │ descriptor │ data …

The checksum is Fletcher's over all bytes before it: their sum, then the sum of the running sums, each modulo 256.

Source: the vendor's public manual ("3DM-GX4-25 Data Communications Protocol"); ``FILTER_BASE_RATE``: its data sheet.
"""

from enum import IntEnum
from struct import Struct
from typing import Annotated

from msgspec import Meta

from valor.common.table import Positive
from valor.devices.table import Device

SYNC = b"\x75\x65"
HEADER_SIZE = 4
CHECKSUM_SIZE = 2

STANDARD_GRAVITY = 9.80665  # [m/s²]
FILTER_BASE_RATE = 500  # [Hz]
FILTER_STREAM = 0x03  # device selector of ``ThreeDm.ENABLE_STREAM``
APPLY, READ = 0x01, 0x02  # first byte of commands that set something


class DescriptorSet(IntEnum):
    """Subject of a packet; a reply has that of its command."""

    BASE = 0x01
    THREE_DM = 0x0C
    FILTER_DATA = 0x82


class Base(IntEnum):
    """Commands of ``DescriptorSet.BASE``."""

    PING = 0x01
    SET_TO_IDLE = 0x02  # streams stop until RESUME
    DEVICE_INFORMATION = 0x03
    RESUME = 0x06


class ThreeDm(IntEnum):
    """Commands of ``DescriptorSet.THREE_DM``."""

    FILTER_MESSAGE_FORMAT = 0x0A
    FILTER_BASE_RATE = 0x0B
    ENABLE_STREAM = 0x11


class Reply(IntEnum):
    """Fields of replies."""

    ACKNOWLEDGE = 0xF1  # descriptor of the command, ``Result``
    DEVICE_INFORMATION = 0x81
    FILTER_MESSAGE_FORMAT = 0x82
    FILTER_BASE_RATE = 0x8A


class Result(IntEnum):
    """Result of a command."""

    OK = 0x00
    UNKNOWN_COMMAND = 0x01
    INVALID_PARAMETER = 0x03


class FilterData(IntEnum):
    """Fields of ``DescriptorSet.FILTER_DATA``; the first three end with a valid flag."""

    ATTITUDE_QUATERNION = 0x03  # w, x, y, z: of the sensor in north-east-down
    COMPENSATED_ANGULAR_RATE = 0x0E  # [rad/s]
    COMPENSATED_ACCELERATION = 0x1C  # specific force, with gravity [m/s²]
    STATUS = 0x10  # state, dynamics mode, flags
    GPS_TIMESTAMP = 0x11  # time of week [s], week, flags


RUNNING_VALID = 0x02  # state in ``FilterData.STATUS``

LAYOUTS: dict[int, Struct] = {
    FilterData.ATTITUDE_QUATERNION: Struct(">4fH"),
    FilterData.COMPENSATED_ANGULAR_RATE: Struct(">3fH"),
    FilterData.COMPENSATED_ACCELERATION: Struct(">3fH"),
    FilterData.STATUS: Struct(">HHH"),
    FilterData.GPS_TIMESTAMP: Struct(">dHH"),
}

DEVICE_INFORMATION = Struct(">H16s16s16s16s16s")
"""Firmware (1126: 1.1.26), model name, model number, serial number, lot number, options; padded with blanks."""

FORMAT_ENTRY = Struct(">BH")
"""Entry of a message format: descriptor, decimation of the base rate."""


class MicroStrainMip(Device, tag="microstrain_mip"):
    """An inertial measurement unit that speaks MIP on a serial port."""

    model: str
    serial: str
    firmware: str
    rate: Positive  # of its data packets [Hz]
    baud_rate: Annotated[int, Meta(gt=0)] = 921600
