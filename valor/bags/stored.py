"""Messages of a ROS 2 bag of any recorder as bytes, also if the bag is damaged.

MCAP files and folders of them are read from start to end without an index. Damage is skipped and reported: a chunk that
does not match its checksum, a missing end.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from valor.bags.errors import BagError
from valor.bags.files import SUFFIX
from valor.common.resources import robot_folder, robots

_MAGIC = b"\x89MCAP"


@dataclass(frozen=True)
class StoredTopic:
    """A topic according to the bag."""

    name: str  # of the topic
    type: str  # such as ``sensor_msgs/msg/JointState``
    definition: str  # text of the type and of the types that it contains; empty if the bag has none
    encoding: str = "ros2msg"  # of the definition, ``ros2msg`` or ``ros2idl``
    serialization: str = "cdr"  # of the messages; only ``cdr`` is supported
    latched: bool = False  # late subscribers received the last message


class StoredMessage(NamedTuple):
    """A message in the bag; times in nanoseconds of the recorder's wall clock."""

    topic: StoredTopic
    received: int
    data: bytes
    sent: int  # by the publisher


@dataclass
class Condition:
    """The condition of a bag, as far as it has been read."""

    messages: int = 0  # number read
    size: int = 0  # of the files [B]
    damage: list[str] = field(default_factory=list)  # descriptions, one line each; empty if the bag is intact
    truncated: int = 0  # number of files that end early; each is a line of ``damage``
    # the recorder's metadata ``valor``; empty in a bag of another recorder
    origin: dict[str, str] = field(default_factory=dict)


class StoredBag:
    """A bag, opened for reading. Raises BagError: the path has no bag. ``condition``: after the last message."""

    def __init__(self, path: Path) -> None:
        self.path = path  # the file, or the folder of files
        self.files = _files(path)  # in the order of recording
        self.condition = Condition(size=sum(file.stat().st_size for file in self.files))

    def messages(self) -> Iterator[StoredMessage]:
        for file in self.files:
            for message in _messages(file, self.condition):
                self.condition.messages += 1
                yield message


def _files(path: Path) -> list[Path]:
    try:
        found = sorted(path.glob(f"*{SUFFIX}"), key=_position) if path.is_dir() else [path]
        if not found:
            raise BagError(f"{path}: no bag; expected files *{SUFFIX}")
        for file in found:
            with open(file, "rb") as opened:
                if opened.read(len(_MAGIC)) != _MAGIC:
                    raise BagError(f"{file}: not MCAP; expected a bag of ROS 2 as MCAP; `rosbags-convert` converts")
    except OSError as error:
        raise BagError(f"{error.filename or path}: {error.strerror}; expected a bag of ROS 2") from None
    return found


def _position(file: Path) -> tuple[str, int, str]:
    """Sort key of the pieces of a bag, whose numbers are not always padded."""
    stem, _, number = file.stem.rpartition("_")
    return (stem, int(number), "") if number.isdecimal() else (file.stem, -1, "")


def _messages(file: Path, condition: Condition) -> Iterator[StoredMessage]:
    schemas: dict[int, Schema] = {}
    topics: dict[int, StoredTopic] = {}
    lost = 0
    with open(file, "rb") as opened:
        for record in _records(opened, file, condition):
            contained: list[McapRecord] = [record]
            if isinstance(record, Chunk):
                try:
                    contained = breakup_chunk(record, validate_crc=True)
                except Exception as error:  # each decompressor raises its own errors
                    lost += 1
                    if lost == 1:
                        condition.damage.append(f"{file}: a damaged chunk is left out: {_one_line(error)}")
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


def _records(opened: BinaryIO, file: Path, condition: Condition) -> Iterator[McapRecord]:
    """Every record outside chunks, up to the first that cannot be parsed."""
    finished, at = False, 0
    try:
        for record in StreamReader(opened, emit_chunks=True).records:
            if isinstance(record, Metadata) and record.name == "valor":
                condition.origin = dict(record.metadata)
            finished |= isinstance(record, Footer)
            yield record
            at = opened.tell()
    except Exception as error:  # each kind of record raises its own errors
        size = file.stat().st_size
        if opened.tell() < size:
            condition.damage.append(f"{file}: unreadable from byte {at} of {size} on: {_one_line(error)}")
        elif not finished:
            condition.truncated += 1
            condition.damage.append(f"{file}: ends in the middle; {at} of {size} bytes are whole")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _topic(channel: Channel, schema: Schema | None) -> StoredTopic:
    if schema is None:
        return StoredTopic(channel.topic, "", "", "", channel.message_encoding)
    text = schema.data.decode(errors="replace")
    # rosbag2 writes the offered QoS as YAML, with words or, in older bags, numbers.
    qos = channel.metadata.get("offered_qos_profiles", "")
    latched = "durability: transient_local" in qos or "durability: 1" in qos
    return StoredTopic(channel.topic, schema.name, text, schema.encoding, channel.message_encoding, latched)


def origin_of(bag: Path) -> dict[str, str]:
    """The recorder's metadata ``valor``; empty in a bag of another recorder. Raises ``BagError`` without a bag."""
    stored = StoredBag(bag)
    next(stored.messages(), None)  # the metadata precedes all messages
    return stored.condition.origin


def robot_of(bag: Path, origin: Mapping[str, str]) -> Path:
    """The folder of the robot in a bag; raises ``BagError`` if the bag names none that is installed."""
    name, folder = origin.get("robot"), origin.get("robot_folder")
    if folder and (Path(folder) / "robot.yaml").is_file():
        return Path(folder)
    if name in robots():
        return robot_folder(name)
    what = f"robot {name!r} is not installed" if name else "names no robot"
    raise BagError(f"{bag}: {what}; expected --robot with one of {', '.join(robots())}, or its folder")
