"""What protects frames from end to end, on buses whose own checks end at their transceivers.

The last two bytes of every frame are a checksum over the others that begins from the frame's identifier, so that a
frame of another unit is not taken for one's own (as the data identifier of AUTOSAR's end-to-end profiles).
"""

from __future__ import annotations

from binascii import crc_hqx

SIZE = 2  # of the checksum [B]


def protect(identifier: int, content: bytes) -> bytes:
    """A frame's data: its content with the checksum behind."""
    return content + crc_hqx(content, identifier).to_bytes(SIZE, "little")


def is_sound(identifier: int, data: bytes | bytearray) -> bool:
    """Whether a frame's data have the checksum that belongs to them."""
    return crc_hqx(data[:-SIZE], identifier) == data[-2] | data[-1] << 8
