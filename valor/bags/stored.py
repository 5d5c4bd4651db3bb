"""The messages that a bag of ROS 2 holds, as bytes, whoever wrote it and whatever became of it.

MCAP files, SQLite files and folders of either are read from the beginning to the end without an index. What is damaged
is passed over, and told: an MCAP chunk that does not fit its checksum, rows that SQLite cannot reach, a missing end.
"""

from __future__ import annotations

import contextlib
import heapq
import sqlite3
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from valor.bags.errors import BagError
from valor.bags.event import EVENT, Event

MCAP_MAGIC = b"\x89MCAP"
SQLITE_MAGIC = b"SQLite format 3\0"
SUFFIXES = (".mcap", ".db3")
_WINDOW = 1_000_000_000  # within which a bag's messages may stand out of order [ns]
_FARTHEST = 1 << 32  # rows that may be unreachable between two that are not


@dataclass(frozen=True)
class StoredTopic:
    """A topic as the bag describes it.

    Attributes:
        type: as ``sensor_msgs/msg/JointState``.
        definition: the text of the type with all it contains; empty: the bag has none.
        encoding: of the definition, ``ros2msg`` or ``ros2idl``.
        serialization: of its messages; ``cdr`` alone is understood.
    """

    name: str
    type: str
    definition: str
    encoding: str = "ros2msg"
    serialization: str = "cdr"
    latched: bool = False  # late-comers got the last message


class StoredMessage(NamedTuple):
    """A message as the bag has it; times in nanoseconds of the recorder's wall clock."""

    topic: StoredTopic
    received: int
    data: bytes
    sent: int  # by the publisher; SQLite bags do not say, it is ``received`` there


@dataclass
class Condition:
    """What became clear of a bag while it was read.

    Attributes:
        messages: read so far.
        size: of its files [B].
        damage: what is wrong, in lines; none: it is whole.
        truncated: files that end in the middle, each a line of damage.
        origin: the recorder's metadata ``valor``; empty in a bag of another recorder.
        events: that the recorder noted, as they stand in the bag.
    """

    messages: int = 0
    size: int = 0
    damage: list[str] = field(default_factory=list)
    truncated: int = 0
    origin: dict[str, str] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)


class StoredBag:
    """A bag, opened for reading.

    Attributes:
        path: as given: a file, or a folder of files.
        files: in their order.
        condition: known when all is read.

    Raises:
        BagError: by the constructor: there is no bag there.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.files = _files(path)
        self.condition = Condition(size=sum(file.stat().st_size for file in self.files))

    def messages(self) -> Iterator[StoredMessage]:
        """Every message, in the order in which they stand."""
        for file in self.files:
            with open(file, "rb") as opened:
                is_sqlite = opened.read(len(SQLITE_MAGIC)) == SQLITE_MAGIC
            read = _sqlite_messages if is_sqlite else _mcap_messages
            for message in read(file, self.condition):
                self.condition.messages += 1
                yield message


def in_order(messages: Iterable[StoredMessage]) -> Iterator[StoredMessage]:
    """By the time when they were received: a recorder writes what came on one topic, then on the next."""
    waiting: list[tuple[int, int, StoredMessage]] = []
    newest = 0
    for number, message in enumerate(messages):
        heapq.heappush(waiting, (message.received, number, message))
        newest = max(newest, message.received)
        while waiting[0][0] < newest - _WINDOW:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]


def _files(path: Path) -> list[Path]:
    try:
        if path.is_dir():
            found = sorted((file for file in path.iterdir() if file.suffix in SUFFIXES), key=_place)
            if not found:
                raise BagError(f"{path}: no bag: expected files {' or '.join('*' + suffix for suffix in SUFFIXES)}")
        else:
            found = [path]
        for file in found:
            with open(file, "rb") as opened:
                magic = opened.read(len(SQLITE_MAGIC))
            if magic != SQLITE_MAGIC and not magic.startswith(MCAP_MAGIC):
                raise BagError(f"{file}: neither MCAP nor SQLite; expected a bag of ROS 2")
    except OSError as error:
        raise BagError(f"{error.filename or path}: {error.strerror}; expected a bag of ROS 2") from None
    return found


def _place(file: Path) -> tuple[str, int, str]:
    """Splits end in their number, which is not always padded."""
    stem, _, number = file.stem.rpartition("_")
    return (stem, int(number), "") if number.isdecimal() else (file.stem, -1, "")


# --- MCAP -----------------------------------------------------------------------------------------------------------


def _mcap_messages(file: Path, condition: Condition) -> Iterator[StoredMessage]:
    schemas: dict[int, Schema] = {}
    topics: dict[int, StoredTopic] = {}
    lost = 0
    with open(file, "rb") as opened:
        for record in _mcap_records(opened, file, condition):
            contained: list[McapRecord] = [record]
            if isinstance(record, Chunk):
                try:
                    contained = breakup_chunk(record, validate_crc=True)
                except Exception as error:  # each decompressor has errors of its own
                    lost += 1
                    if lost == 1:
                        condition.damage.append(f"{file}: a damaged chunk is left out: {' '.join(str(error).split())}")
                    continue
            for each in contained:
                if isinstance(each, Message):
                    if each.channel_id in topics:
                        yield StoredMessage(topics[each.channel_id], each.log_time, each.data, each.publish_time)
                elif isinstance(each, Schema):
                    schemas[each.id] = each
                elif isinstance(each, Channel):
                    topics[each.id] = _topic(each, schemas.get(each.schema_id))
    if lost > 1:
        condition.damage.append(f"{file}: {lost} damaged chunks are left out")


def _mcap_records(opened: BinaryIO, file: Path, condition: Condition) -> Iterator[McapRecord]:
    """Every record outside chunks, as far as records can be told apart."""
    reader = StreamReader(opened, emit_chunks=True)
    finished = False
    records = iter(reader.records)
    while True:
        at = opened.tell()
        try:
            record = next(records)
        except StopIteration:
            break
        except Exception as error:  # each kind of record has errors of its own
            size = file.stat().st_size
            if opened.tell() < size:
                text = " ".join(str(error).split()) or type(error).__name__
                condition.damage.append(f"{file}: unreadable from byte {at} of {size} on: {text}")
            elif not finished:
                condition.truncated += 1
                condition.damage.append(f"{file}: ends in the middle; {at} of {size} bytes are whole")
            return
        if isinstance(record, Metadata) and record.name == "valor":
            condition.origin = dict(record.metadata)
        elif isinstance(record, Metadata) and record.name == EVENT and (event := Event.of(record.metadata)):
            condition.events.append(event)
        finished |= isinstance(record, Footer)
        yield record


def _topic(channel: Channel, schema: Schema | None) -> StoredTopic:
    if schema is None:
        return StoredTopic(channel.topic, "", "", "", channel.message_encoding)
    text = schema.data.decode(errors="replace")
    latched = _latched(channel.metadata.get("offered_qos_profiles", ""))
    return StoredTopic(channel.topic, schema.name, text, schema.encoding, channel.message_encoding, latched)


def _latched(qos: str) -> bool:
    """By rosbag2's YAML of the QoS offered, in words or, in older bags, in numbers."""
    return "durability: transient_local" in qos or "durability: 1" in qos


# --- SQLite ---------------------------------------------------------------------------------------------------------


def _sqlite_messages(file: Path, condition: Condition) -> Iterator[StoredMessage]:
    with contextlib.closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)) as database:
        database.execute("PRAGMA writable_schema=ON")  # else a truncated file cannot be read at all
        try:
            topics = _sqlite_topics(database)
        except sqlite3.Error as error:
            condition.damage.append(f"{file}: unreadable: {error}")
            return
        _note_missing_end(file, condition)
        last, unreachable, garbled = 0, 0, False
        while True:
            try:
                for row, topic, stamp, data in database.execute(
                    "SELECT id, topic_id, timestamp, data FROM messages WHERE id > ? ORDER BY id", (last,)
                ):
                    if row <= last:  # a page that is there in part reads as zeros, from its first rows on
                        garbled = True
                        continue
                    last = row
                    if garbled:  # and of the next row the end is missing
                        garbled = False
                        continue
                    if topic in topics and isinstance(data, bytes):
                        yield StoredMessage(topics[topic], stamp, data, stamp)
                break
            except sqlite3.Error as error:
                unreachable += 1
                if unreachable == 1:
                    condition.damage.append(f"{file}: rows behind the {last}th cannot be reached: {error}")
                resumed = _next_readable(database, last)
                if resumed is None:
                    break
                last = resumed - 1


def _note_missing_end(file: Path, condition: Condition) -> None:
    """Hold what the file's header says of its length against the length that it has."""
    with open(file, "rb") as opened:
        header = opened.read(32)
    if len(header) < 32:
        return
    page = int.from_bytes(header[16:18], "big")
    expected = (65536 if page == 1 else page) * int.from_bytes(header[28:32], "big")
    size = file.stat().st_size
    if size < expected:
        condition.truncated += 1
        condition.damage.append(f"{file}: ends in the middle; {size} of {expected} bytes are there")


def _next_readable(database: sqlite3.Connection, last: int) -> int | None:
    """The first row behind a hole in a damaged table: sought in steps that double, then halve; None: there is none."""
    hole, far = last + 1, last + 2
    while not _first_from(database, far)[0]:
        hole, far = far, far + 2 * (far - last)
        if far - last > _FARTHEST:
            return None
    while far - hole > 1:
        middle = (hole + far) // 2
        if _first_from(database, middle)[0]:
            far = middle
        else:
            hole = middle
    row = _first_from(database, far)[1]
    return row if row is not None and row > last else None


def _first_from(database: sqlite3.Connection, row: int) -> tuple[bool, int | None]:
    """Whether the table can be read at a row, and the first that is there from it on."""
    try:
        found = database.execute(
            "SELECT id FROM messages WHERE id >= ? AND length(data) >= 0 ORDER BY id LIMIT 1", (row,)
        ).fetchone()
    except sqlite3.Error:
        return False, None
    return True, None if found is None else int(found[0])


def _sqlite_topics(database: sqlite3.Connection) -> dict[int, StoredTopic]:
    definitions: dict[str, tuple[str, str]] = {}
    with contextlib.suppress(sqlite3.Error):  # since rosbag2's schema 4
        definitions = {
            type_name: (text, encoding)
            for type_name, encoding, text in database.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
        }
    columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
    qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
    return {
        number: StoredTopic(
            name, type_name, *definitions.get(type_name, ("", "ros2msg")), serialization, _latched(offered)
        )
        for number, name, type_name, serialization, offered in database.execute(
            f"SELECT id, name, type, serialization_format, {qos} FROM topics"  # one of two constants
        )
    }
