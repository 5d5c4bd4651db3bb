"""KVH 1750: fiber-optic gyroscopes and accelerometers behind RS-422; its serial protocol.

In normal mode it streams one message per sample (format A), big-endian::

    0xFE 0x81 0xFF 0x55 │ rotation f32 × 3 │ acceleration f32 × 3 │ status │ sequence │ temperature i16 │ CRC
             4          │   x, y, z, 12    │     x, y, z, 12      │   1    │    1     │        2        │  4

In configuration mode it does not stream, and responds to lines of text: to ``=DR,250`` with ``DR,250``, to ``?IS`` with
``IS,`` and its serial number, to unknown lines with ``INVALID`` and the line.

Sources: the vendor's public manual (of the 1775, which has the same format A) for layout, units, status bits, axes and
commands; the public ROS driver of the TREC laboratory (``ros_kvh1750``) for the rates of a 1750, 75 °C, and the missing
response when configuration mode ends. The CRC is CRC-32/MPEG-2: polynomial 0x04C11DB7, start 0xFFFFFFFF, most
significant bit first.
"""

from math import radians
from struct import Struct
from typing import Annotated, Literal

from msgspec import Meta

from valor.devices.table import Device

HEADER = b"\xfe\x81\xff\x55"
MESSAGE = Struct(">4s6fBBh")
"""Without the CRC: header, rotation [rad/s, as configured here], acceleration [g], status, sequence, [°C]."""
CRC_SIZE = 4

SEQUENCES = 128  # range of the count of messages
VALID = 0b0111_0111  # status of valid gyroscopes (bits 0 to 2) and accelerometers (4 to 6)
STANDARD_GRAVITY = 9.80665  # [m/s²]
RATES = (1, 5, 10, 25, 50, 100, 250, 500, 750, 1000)  # [Hz]
WARMEST = 75.0  # limit of its use [°C]
# Its maker's data sheet: angle random walk 0.013 °/√h, bias instability 0.1 °/h; 0.12 mg/√Hz and 0.05 mg with ± 10 g.
DENSITIES = radians(0.013) / 60.0, 0.12e-3 * STANDARD_GRAVITY
"""Noise densities of rate [rad/s/√Hz] and specific force [m/s²/√Hz]."""
BIASES = radians(0.1) / 3600.0, 0.05e-3 * STANDARD_GRAVITY
"""Standard deviations of the biases [rad/s, m/s²]."""


class Kvh1750(Device, tag="kvh_1750"):
    """A KVH 1750 on a serial port: rates and accelerations; its driver computes the attitude."""

    serial: str
    rate: Literal[100, 250, 500, 750, 1000]  # of its messages [Hz]
    baud_rate: Annotated[int, Meta(gt=0)] = 921600
