"""The MCAP library's writer with a shorter way for messages, and a smaller index.

What comes out is the same, byte for byte, which a test holds against the library's own way. That one makes an object a
message and packs its six numbers one by one, which takes twice as long as all the rest. And until the file is finished
it keeps an object a chunk with a number a topic: six chunks a second of fifty topics were a gigabyte a day.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any, Self

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, MessageIndex
from mcap.writer import Writer

_HEAD = struct.Struct("<BQHIQQ")  # opcode, length of the rest, channel, sequence, log time, publish time
_FIXED = _HEAD.size - 9  # of the rest, what stands before the data [B]
_MESSAGE = int(Opcode.MESSAGE)


class _PackedIndex:
    """The index of all chunks as it will stand in the file. To the library it is a list of one record."""

    def __init__(self) -> None:
        self._records = RecordBuilder()

    def append(self, index: ChunkIndex) -> None:
        index.write(self._records)

    def __iter__(self) -> Iterator[Self]:
        yield self

    def write(self, summary: RecordBuilder) -> None:
        summary.write(self._records.end())


class QuickWriter(Writer):  # type: ignore[misc]  # untyped
    """Writes chunks; everything but ``add_message`` and the index until the end is the library's."""

    def __init__(self, output: Any, **options: Any) -> None:
        super().__init__(output, use_chunking=True, **options)
        self._Writer__chunk_indices = _PackedIndex()
        self._chunk: Any = self._Writer__chunk_builder
        self._totals: Any = self._Writer__statistics
        self._finish_large_chunk: Any = self._Writer__maybe_finalize_chunk

    def add_message(self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0) -> None:
        """Add a message to the chunk of now; as the library's."""
        chunk, totals = self._chunk, self._totals
        if totals.message_count == 0 or log_time < totals.message_start_time:
            totals.message_start_time = log_time
        totals.message_end_time = max(totals.message_end_time, log_time)
        totals.channel_message_counts[channel_id] += 1
        totals.message_count += 1
        if chunk.num_messages == 0 or log_time < chunk.message_start_time:
            chunk.message_start_time = log_time
        chunk.message_end_time = max(chunk.message_end_time, log_time)
        index = chunk.message_indices.get(channel_id)
        if index is None:
            index = chunk.message_indices[channel_id] = MessageIndex(channel_id=channel_id, records=[])
        records = chunk.record_writer
        index.records.append((log_time, records.count))
        chunk.num_messages += 1
        records.write(_HEAD.pack(_MESSAGE, _FIXED + len(data), channel_id, sequence, log_time, publish_time))
        records.write(data)
        self._finish_large_chunk()
