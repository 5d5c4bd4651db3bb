"""Index of a bag: the summary section at the end of a finished MCAP file."""

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
_CHUNKS = (Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX)  # skipped: thousands per hour, unused here


@dataclass(frozen=True)
class BagIndex:
    """Channels and schemas by number, statistics, and metadata records of a bag."""

    channels: dict[int, Channel]
    schemas: dict[int, Schema]
    statistics: Statistics
    metadata: list[Metadata]


def read_index(bag: Path) -> BagIndex | None:
    """Read the index of a bag without its chunks, in a time that does not depend on the bag's size.

    None if the bag is finished but has no index. Raises BagError: the file is not MCAP, is truncated or damaged;
    OSError: it cannot be read.
    """
    try:
        with open(bag, "rb") as file:
            summary = _read_summary(file)
            if summary is None or summary.statistics is None:
                return None
            metadata = []
            for each in summary.metadata_indexes:
                file.seek(each.offset + _RECORD_HEAD)
                metadata.append(Metadata.read(ReadDataStream(file)))
    except (McapError, ValueError, StructError):
        raise BagError(f"{bag}: not a whole MCAP file") from None
    return BagIndex(summary.channels, summary.schemas, summary.statistics, metadata)


def _read_summary(file: BinaryIO) -> Summary | None:
    """Read the summary's short groups, located by the offsets at its end; the library would read all groups."""
    size = file.seek(0, io.SEEK_END)
    end = file.seek(max(0, size - FOOTER_SIZE - MAGIC_SIZE))
    tail = file.read()
    (footer,) = _records(tail)  # ValueError if there are more records
    if not isinstance(footer, Footer):
        raise McapError("no footer")
    if footer.summary_start == 0:
        return None
    if footer.summary_offset_start == 0:
        complete: Summary | None = make_reader(file).get_summary()
        return complete
    summary = Summary()
    file.seek(footer.summary_offset_start)
    for offset in _records(file.read(end - footer.summary_offset_start) + tail):
        if not isinstance(offset, SummaryOffset) or offset.group_opcode in _CHUNKS:
            continue
        file.seek(offset.group_start)
        for record in _records(file.read(offset.group_length) + tail):
            if isinstance(record, Statistics):
                summary.statistics = record
            elif isinstance(record, Schema):
                summary.schemas[record.id] = record
            elif isinstance(record, Channel):
                summary.channels[record.id] = record
            elif isinstance(record, MetadataIndex):
                summary.metadata_indexes.append(record)
    return summary


def _records(part: bytes) -> list[Any]:
    """The records of a part of a file, followed by the end of the file, which ends the library's parsing."""
    return list(StreamReader(io.BytesIO(part), skip_magic=True).records)
