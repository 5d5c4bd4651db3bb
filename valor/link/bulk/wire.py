"""What the two ends say to each other about things: a chunk as it is, all else in MessagePack.

The operator's end asks what is new and for chunks; the robot's describes, and sends chunks. The first byte of a content
is ``0`` for a chunk, followed by the thing's tag (8), the chunk's place (4) and its bytes; or ``1``.
"""

from __future__ import annotations

import re
import struct
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from valor.link.classes import Bulk
from valor.link.errors import SealError

CHUNK = 1350  # [B]; a datagram fits through a tunnel of 1,420 B, too
TAG = 8  # of a digest, by which a thing is spoken of [B]
LONGEST_NAME = 96
MOST_RANGES = 150  # of chunks in one datagram
LARGEST = 2**32 * CHUNK  # of a thing [B]
_NAME = re.compile(rf"[A-Za-z0-9][A-Za-z0-9._-]{{0,{LONGEST_NAME - 1}}}")
_CHUNK = struct.Struct(f">B{TAG}sI")

Count = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Tag = Annotated[bytes, Meta(min_length=TAG, max_length=TAG)]


class Described(Struct, frozen=True, array_like=True):
    """A thing that is to be had.

    Attributes:
        name: a file's, without a folder; a picture's: the frame of its camera.
        size: [B].
        digest: SHA-256.
        clock: when it was so, by the robot end's clock [ms]; 0: it does not age.
        form: of a picture, as ``sensor_msgs/CompressedImage`` has it.
    """

    kind: Bulk
    name: Annotated[str, Meta(max_length=LONGEST_NAME)]
    size: Annotated[int, Meta(ge=0, le=LARGEST)]
    digest: Annotated[bytes, Meta(min_length=32, max_length=32)]
    clock: Annotated[int, Meta(ge=0)] = 0
    form: Annotated[str, Meta(max_length=64)] = ""

    @property
    def tag(self) -> bytes:
        """By which its chunks are asked for."""
        return self.digest[:TAG]


class Ask(Struct, frozen=True, array_like=True, tag="ask"):
    """What is new? And what of the bag ``about``? The answer shows that the channel is there."""

    about: Annotated[str, Meta(max_length=LONGEST_NAME)] = ""


class Want(Struct, frozen=True, array_like=True, tag="want"):
    """Chunks of a thing: from, how many."""

    thing: Tag
    ranges: Annotated[tuple[tuple[Count, Count], ...], Meta(max_length=MOST_RANGES)]


class News(Struct, frozen=True, array_like=True, tag="news"):
    """Answers ``Ask``.

    Attributes:
        things: the newest picture, the newest list of bags, and what was asked about, as far as they are there.
        about: what was asked about.
        refused: why that is not to be had; empty: it is, or it is being looked at.
    """

    things: Annotated[tuple[Described, ...], Meta(max_length=4)]
    about: Annotated[str, Meta(max_length=LONGEST_NAME)] = ""
    refused: Annotated[str, Meta(max_length=300)] = ""


class Gone(Struct, frozen=True, array_like=True, tag="gone"):
    """Nothing with this tag is to be had; it may be asked about anew."""

    thing: Tag


class Chunk(Struct, frozen=True):
    """Some bytes of a thing, at ``place`` × ``CHUNK``."""

    thing: bytes
    place: int
    content: bytes


Word = Ask | Want | News | Gone
_DECODER: msgspec.msgpack.Decoder[Word] = msgspec.msgpack.Decoder(Word)
_encode = msgspec.msgpack.Encoder().encode


def checked_name(name: str) -> str:
    """A name that is a file's in any folder.

    Raises:
        SealError: it is not.
    """
    if not _NAME.fullmatch(name):
        raise SealError(f"name {name!r:.120}: expected letters, digits, '.', '_' and '-', {LONGEST_NAME} at most")
    return name


def said(word: Word) -> bytes:
    """As it travels, before it is sealed."""
    return b"\1" + _encode(word)


def chunk(thing: bytes, place: int, content: bytes) -> bytes:
    """As it travels, before it is sealed."""
    return _CHUNK.pack(0, thing, place) + content


def heard(content: bytes) -> Word | Chunk:
    """The inverse of both.

    Raises:
        SealError: it is neither.
    """
    if content[:1] == b"\0" and len(content) >= _CHUNK.size:
        _, thing, place = _CHUNK.unpack_from(content)
        return Chunk(thing, place, content[_CHUNK.size :])
    if content[:1] != b"\1":
        raise SealError("expected a chunk or a word")
    try:
        return _DECODER.decode(content[1:])
    except (msgspec.DecodeError, RecursionError) as error:
        raise SealError(f"a word of the fast channel: {error}") from None
