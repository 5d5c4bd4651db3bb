"""Verbs of valorctl that travel to the robot's side, and what is said to them: deflated text, which both ends know."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import msgspec

from valor.common.processes import BY_NAME
from valor.link.errors import SealError

LONGEST = 4000  # of what is said to one, as it travels: about a minute of what states leave [B]
_BOUND = 1 << 20  # of it, inflated [B]
_DICTIONARY = (
    "".join(
        f'["{name}","{state}",'
        for name, state in zip(BY_NAME, ("failed", "stopped", "starting", "degraded"), strict=False)
    ).encode()
    + "".join(f'],["{name}","ready",' for name in BY_NAME).encode()
)


def deflated(text: str) -> bytes:
    """As it travels."""
    deflate = zlib.compressobj(9, zlib.DEFLATED, -15, 9, zlib.Z_DEFAULT_STRATEGY, _DICTIONARY)
    return deflate.compress(text.encode()) + deflate.flush()


def _inflated(data: bytes) -> str:
    try:
        return zlib.decompressobj(-15, _DICTIONARY).decompress(data, _BOUND).decode()
    except (zlib.error, UnicodeDecodeError) as error:
        raise SealError(f"a verb, or what was said to one: {error}") from None


def pack_verb(words: Sequence[str]) -> bytes:
    """A verb with its arguments."""
    return deflated(msgspec.json.encode(list(words)).decode())


def read_verb(data: bytes) -> list[str]:
    """The inverse of ``pack_verb``.

    Raises:
        SealError: it is none.
    """
    try:
        return msgspec.json.decode(_inflated(data), type=list[str])
    except msgspec.MsgspecError as error:
        raise SealError(f"a verb: {error}") from None


def pack_said(status: int, text: str) -> bytes:
    """Its exit status and what was said to it, as much as ``LONGEST`` takes."""
    said = deflated(text)
    if len(said) > LONGEST:
        status, said = 1, deflated(f"said {len(text)} characters; expected what {LONGEST} bytes can carry")
    return bytes((status & 0xFF,)) + said


def read_said(data: bytes) -> tuple[int, str]:
    """The inverse of ``pack_said``.

    Raises:
        SealError: it is none.
    """
    if not data:
        raise SealError("what was said to a verb: empty")
    return data[0], _inflated(data[1:])
