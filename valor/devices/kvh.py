"""KVH 1750: fiber-optic gyroscopes and accelerometers behind RS-422; the numbers of its serial protocol.

In normal mode it streams one message a sample (format A), big-endian::

    0xFE 0x81 0xFF 0x55 │ rotation f32 × 3 │ acceleration f32 × 3 │ status │ sequence │ temperature i16 │ CRC
             4          │   x, y, z, 12    │     x, y, z, 12      │   1    │    1     │        2        │  4

In configuration mode it is silent, and answers lines of text: ``=DR,250`` is answered by ``DR,250``, ``?IS`` by
``IS,`` and its serial number, and what it does not know by ``INVALID`` and the line.

From the vendor's public manual (of the 1775, whose format A is the 1750's): layout, units, status bits, axes, text
commands. From the public ROS driver of the TREC laboratory for this sensor (``ros_kvh1750``): that leaving
configuration mode is not answered, the rates of a 1750, and 75 °C.
"""

from __future__ import annotations

from struct import Struct
from typing import Annotated, Literal

from msgspec import Meta

from valor.devices.table import Device

HEADER = b"\xfe\x81\xff\x55"
MESSAGE = Struct(">4s6fBBh")
"""Without the CRC: header, rotation [rad/s, as it is set up here], acceleration [g], status, sequence, [°C]."""
CRC_SIZE = 4
CRC_POLYNOMIAL, CRC_START = 0x04C11DB7, 0xFFFFFFFF  # most significant bit first, nothing reflected or inverted

SEQUENCES = 128  # the count of messages goes from 0 to 127, and begins anew
VALID = 0b0111_0111  # status when all gyroscopes (bits 0 to 2) and accelerometers (4 to 6) are well
STANDARD_GRAVITY = 9.80665  # [m/s²]
RATES = (1, 5, 10, 25, 50, 100, 250, 500, 750, 1000)  # [Hz]
WARMEST = 75.0  # in which it may be used [°C]


class Kvh1750(Device, tag="kvh_1750"):
    """An inertial measurement unit of KVH's on a serial port: rates and accelerations; its driver makes an attitude."""

    serial: str
    rate: Literal[100, 250, 500, 750, 1000]  # of its messages [Hz]
    baud_rate: Annotated[int, Meta(gt=0)] = 921600
