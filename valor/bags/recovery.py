"""Recovery of an unfinished bag in place, without copying messages.

An MCAP file is a sequence of records. A killed recorder leaves complete records, perhaps followed by part of a record,
and no index. ``recover`` reads the complete records, cuts off the rest, and writes the index (the summary section).
Chunks are verified by their checksums.
"""

import fcntl
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from valor.bags.errors import BagError
from valor.bags.files import LIBRARY, PROFILE
from valor.bags.index import read_index

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQ")  # channel, sequence, log time


@dataclass(frozen=True)
class RecoveredBag:
    """Result of ``recover``."""

    path: Path  # the file
    finished: bool  # the bag was complete, and is unchanged
    messages: int  # number of messages in the bag
    bytes_cut: int  # size of an incomplete record that was cut off [B]


@dataclass
class _Contents:
    """Contents of the complete records of a file."""

    end: int = 0  # of the last complete record [B from the start]
    has_header: bool = False
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    chunks: list[records.ChunkIndex] = field(default_factory=list)
    metadata: list[records.MetadataIndex] = field(default_factory=list)
    attachments: int = 0
    counts: dict[int, int] = field(default_factory=lambda: defaultdict(int))
    times: list[int] = field(default_factory=list)  # first and last log time of every chunk
    last_indices: list[records.MessageIndex] = field(default_factory=list)  # expected after the last chunk


def recover(path: Path) -> RecoveredBag:
    """Finish an unfinished bag; a finished one stays unchanged.

    Raises BagError: the file is missing, not MCAP, being recorded, not writable, or finished with a damaged index.
    """
    try:
        with open(path, "r+b") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise BagError(f"{path}: is being recorded; stop the recorder first") from None
            return _recover(file, path)
    except OSError as error:
        raise BagError(f"{path}: {error.strerror}") from None


def _recover(file: BinaryIO, path: Path) -> RecoveredBag:
    size = file.seek(0, 2)
    if _is_finished(file, size):
        index = read_index(path)
        return RecoveredBag(path, True, index.statistics.message_count if index else 0, 0)
    file.seek(0)
    magic = file.read(len(MCAP0_MAGIC))
    if magic != MCAP0_MAGIC[: len(magic)]:
        raise BagError(f"{path}: not an MCAP file")
    contents = _read(file, size)
    file.truncate(contents.end)
    file.seek(contents.end)
    _write_end(file, contents)
    return RecoveredBag(path, False, sum(contents.counts.values()), size - contents.end)


def _is_finished(file: BinaryIO, size: int) -> bool:
    footer_size = _RECORD.size + 20
    tail = footer_size + len(MCAP0_MAGIC)
    if size < tail:
        return False
    file.seek(size - tail)
    content = file.read(tail)
    return content.endswith(MCAP0_MAGIC) and _RECORD.unpack_from(content) == (Opcode.FOOTER, 20)


def _whole_records(file: BinaryIO, size: int) -> Iterator[tuple[int, int, bytes]]:
    """Opcode, offset and content of every complete record, up to the end of the data section."""
    offset = len(MCAP0_MAGIC)
    while offset + _RECORD.size <= size:
        file.seek(offset)
        opcode, length = _RECORD.unpack(file.read(_RECORD.size))
        if offset + _RECORD.size + length > size or opcode == Opcode.DATA_END:
            return
        yield opcode, offset, file.read(length)
        offset += _RECORD.size + length


def _read(file: BinaryIO, size: int) -> _Contents:
    contents = _Contents()
    expected: dict[int, records.MessageIndex] = {}  # of the last chunk, by channel
    found = 0
    for opcode, offset, content in _whole_records(file, size):
        end = offset + _RECORD.size + len(content)
        if opcode == Opcode.CHUNK:
            try:
                expected = _read_chunk(content, offset, contents)
            except Exception:  # each decompressor raises its own errors
                break  # corrupted: later records are not trusted either
            contents.end, found = end, 0
            contents.last_indices = list(expected.values())
        elif opcode == Opcode.MESSAGE_INDEX and contents.chunks:
            chunk = contents.chunks[-1]
            chunk.message_index_offsets[struct.unpack_from("<H", content)[0]] = offset
            chunk.message_index_length = end - contents.end
            found += 1
            if found == len(expected):
                contents.end, contents.last_indices = end, []
        elif opcode == Opcode.METADATA:
            name = records.Metadata.read(_stream(content)).name
            contents.metadata.append(records.MetadataIndex(offset=offset, length=end - offset, name=name))
            contents.end = end
        else:
            contents.has_header |= opcode == Opcode.HEADER
            contents.attachments += opcode == Opcode.ATTACHMENT
            contents.end = end
    return contents


def _read_chunk(content: bytes, offset: int, contents: _Contents) -> dict[int, records.MessageIndex]:
    chunk = records.Chunk.read(_stream(content))
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    data = stream.read(length)
    indices: dict[int, records.MessageIndex] = {}
    position = 0
    while position < length:
        opcode, size = _RECORD.unpack_from(data, position)
        start = position + _RECORD.size
        if opcode == Opcode.MESSAGE:
            channel, _, log_time = _MESSAGE.unpack_from(data, start)
            index = indices.get(channel)
            if index is None:
                index = indices[channel] = records.MessageIndex(channel, [])
            index.records.append((log_time, position))
        elif opcode == Opcode.SCHEMA:
            schema = records.Schema.read(_stream(data[start : start + size]))
            contents.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            opened = records.Channel.read(_stream(data[start : start + size]))
            contents.channels[opened.id] = opened
        position = start + size
    for index in indices.values():
        contents.counts[index.channel_id] += len(index.records)
    contents.times += (chunk.message_start_time, chunk.message_end_time)
    contents.chunks.append(
        records.ChunkIndex(
            message_start_time=chunk.message_start_time,
            message_end_time=chunk.message_end_time,
            chunk_start_offset=offset,
            chunk_length=_RECORD.size + len(content),
            message_index_offsets={},
            message_index_length=0,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            uncompressed_size=chunk.uncompressed_size,
        )
    )
    return indices


def _write_end(file: BinaryIO, contents: _Contents) -> None:
    """Write indices, end of data, summary and footer at ``contents.end``, the position of ``file``."""
    builder = RecordBuilder()
    if not contents.end:
        builder.write(MCAP0_MAGIC)
    if not contents.has_header:
        records.Header(PROFILE, LIBRARY).write(builder)
    if contents.last_indices:
        chunk = contents.chunks[-1]
        start = builder.count
        chunk.message_index_offsets.clear()
        for index in contents.last_indices:
            chunk.message_index_offsets[index.channel_id] = contents.end + builder.count
            index.write(builder)
        chunk.message_index_length = builder.count - start
    records.DataEnd(0).write(builder)
    data = builder.end()
    summary_start = contents.end + len(data)

    statistics = records.Statistics(
        attachment_count=contents.attachments,
        channel_count=len(contents.channels),
        channel_message_counts=dict(contents.counts),
        chunk_count=len(contents.chunks),
        message_count=sum(contents.counts.values()),
        metadata_count=len(contents.metadata),
        message_start_time=min(contents.times, default=0),
        message_end_time=max(contents.times, default=0),
        schema_count=len(contents.schemas),
    )
    groups: list[tuple[Opcode, list[records.McapRecord]]] = [
        (Opcode.SCHEMA, list(contents.schemas.values())),
        (Opcode.CHANNEL, list(contents.channels.values())),
        (Opcode.STATISTICS, [statistics]),
        (Opcode.CHUNK_INDEX, list(contents.chunks)),
        (Opcode.METADATA_INDEX, list(contents.metadata)),
    ]
    offsets = []
    for opcode, group in groups:
        start = builder.count
        for record in group:
            record.write(builder)
        if group:
            offsets.append(records.SummaryOffset(opcode, summary_start + start, builder.count - start))
    offset_start = summary_start + builder.count
    for offset in offsets:
        offset.write(builder)
    summary = builder.end()

    footer_head = struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, offset_start)
    records.Footer(summary_start, offset_start, zlib.crc32(footer_head, zlib.crc32(summary))).write(builder)
    file.write(data + summary + builder.end() + MCAP0_MAGIC)


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))
