"""A bag's index: the summary section at the end of an MCAP file that was finished."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from struct import error as StructError  # noqa: N812
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE, make_reader
from mcap.records import Channel, Footer, Metadata, MetadataIndex, Schema, Statistics, SummaryOffset
from mcap.stream_reader import MAGIC_SIZE, StreamReader
from mcap.summary import Summary

from valor.bags.errors import BagError

_RECORD_HEAD = 9  # of a record: opcode and length [B]
_CHUNKS = (Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX)  # left out: thousands an hour, that nobody asks for here


@dataclass(frozen=True)
class BagIndex:
    """What a bag holds: channels, schemas and where its metadata is, and how many messages from when to when."""

    summary: Summary
    statistics: Statistics


def read_index(bag: Path) -> BagIndex | None:
    """The index of a bag, but for its chunks; None if it is whole but has none. As quick for 4 GB as for 4 MB.

    Raises:
        BagError: it is no MCAP file, or was cut off or damaged.
        OSError: it cannot be read.
    """
    try:
        with open(bag, "rb") as file:
            summary = _read(file)
    except (McapError, ValueError, StructError):
        raise BagError(f"{bag}: not a whole MCAP file") from None
    if summary is None or summary.statistics is None:
        return None
    return BagIndex(summary, summary.statistics)


def read_metadata(bag: Path, index: BagIndex, name: str) -> list[dict[str, str]]:
    """The metadata records of that name, in their order.

    Raises:
        OSError: the bag cannot be read.
    """
    found = []
    with open(bag, "rb") as file:
        for each in index.summary.metadata_indexes:
            if each.name == name:
                file.seek(each.offset + _RECORD_HEAD)
                found.append(Metadata.read(ReadDataStream(file)).metadata)
    return found


def _read(file: BinaryIO) -> Summary | None:
    """The library reads all of the summary; the offsets at its end say where its short parts stand."""
    size = file.seek(0, io.SEEK_END)
    end = file.seek(max(0, size - FOOTER_SIZE - MAGIC_SIZE))
    tail = file.read()
    (footer,) = _records(tail)  # a ValueError, if it is more than that
    if not isinstance(footer, Footer):
        raise McapError("no footer")
    if footer.summary_start == 0:
        return None
    if footer.summary_offset_start == 0:
        whole: Summary | None = make_reader(file).get_summary()
        return whole
    summary = Summary()
    file.seek(footer.summary_offset_start)
    for offset in _records(file.read(end - footer.summary_offset_start) + tail):
        if isinstance(offset, SummaryOffset) and offset.group_opcode not in _CHUNKS:
            file.seek(offset.group_start)
            _add(summary, _records(file.read(offset.group_length) + tail))
    return summary


def _records(part: bytes) -> list[Any]:
    """The records of a part of a file that ends as the file does: by that the library knows the end."""
    return list(StreamReader(io.BytesIO(part), skip_magic=True).records)


def _add(summary: Summary, records: list[Any]) -> None:
    for record in records:
        if isinstance(record, Statistics):
            summary.statistics = record
        elif isinstance(record, Schema):
            summary.schemas[record.id] = record
        elif isinstance(record, Channel):
            summary.channels[record.id] = record
        elif isinstance(record, MetadataIndex):
            summary.metadata_indexes.append(record)
