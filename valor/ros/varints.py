"""Whole numbers as few bytes, small ones of either sign in one: seven bits in each byte, the least first."""

from __future__ import annotations

from valor.link.errors import SealError


def varint(number: int) -> bytes:
    """One number."""
    rest = number << 1 if number >= 0 else ~(number << 1)
    found = bytearray()
    while rest >= 0x80:
        found.append(rest & 0x7F | 0x80)
        rest >>= 7
    found.append(rest)
    return bytes(found)


def varints(data: bytes, at: int = 0, count: int | None = None) -> tuple[list[int], int]:
    """Numbers from a place on, so many or as many as there are, and where they end.

    Raises:
        SealError: one is longer than 63 bits, or there are fewer.
    """
    found: list[int] = []
    number = shift = 0
    while at < len(data) and len(found) != count:
        byte = data[at]
        at += 1
        number |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            found.append(number >> 1 if not number & 1 else ~(number >> 1))
            number = shift = 0
        elif shift > 63:
            raise SealError("a number is too long")
    if count is not None and len(found) < count:
        raise SealError(f"{len(found)} numbers; expected {count}")
    return found, at
