"""Contents of a bag from its index, and the recordings of instances as ``bag list`` shows them."""

import contextlib
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from valor.bags import recordings, rosbag2_metadata
from valor.bags.errors import BagError
from valor.bags.files import SUFFIX, origin
from valor.bags.index import BagIndex, read_index
from valor.common.errors import ValorError
from valor.common.instance import Instance


class RecordedTopic(NamedTuple):
    """One topic of a bag; ``rate`` is the mean over the duration of the bag [Hz]."""

    name: str
    type: str
    messages: int
    rate: float


@dataclass(frozen=True)
class BagSummary:
    """Contents of a bag: size [B], start on the wall clock [s], duration [s], messages, topics."""

    file: Path
    size: int
    start: float
    duration: float
    messages: int
    topics: list[RecordedTopic]

    def as_json(self) -> dict[str, Any]:
        """The object of ``bag info --json``."""
        topics = [topic._asdict() for topic in self.topics]
        return vars(self) | {"file": str(self.file), "topics": topics}


def summarize(path: Path) -> BagSummary:
    """Read the index of a bag, file or folder of pieces; raises ``ValorError`` if it is missing or not finished."""
    files = sorted(path.glob(f"*{SUFFIX}")) if path.is_dir() else [path]
    if not files:
        raise ValorError(f"{path}: no bag; expected files *{SUFFIX}; `valorctl bag list` shows recordings")
    counts: Counter[tuple[str, str]] = Counter()
    indices = [_index(file) for file in files]
    for index in indices:
        for channel in index.channels.values():
            schema = index.schemas.get(channel.schema_id)
            key = (channel.topic, schema.name if schema else "")
            counts[key] += index.statistics.channel_message_counts.get(channel.id, 0)
    held = [index.statistics for index in indices if index.statistics.message_count]
    start = min((each.message_start_time for each in held), default=0)
    duration = (max((each.message_end_time for each in held), default=0) - start) * 1e-9
    topics = [
        RecordedTopic(*names, count, count / duration if duration else 0.0) for names, count in sorted(counts.items())
    ]
    size, messages = sum(file.stat().st_size for file in files), sum(each.message_count for each in held)
    return BagSummary(path, size, start * 1e-9, duration, messages, topics)


def _index(file: Path) -> BagIndex:
    try:
        index = read_index(file)
    except OSError as error:
        raise ValorError(f"{file}: {error.strerror}") from None
    except BagError as error:
        raise ValorError(f"{error}; `valorctl bag recover {file}` finishes a truncated one") from None
    if index is None:
        raise ValorError(f"{file}: no index; `valorctl bag recover {file}` adds it after the end of the recorder")
    return index


@dataclass(frozen=True)
class Row:
    """One recording of ``bag list``."""

    name: str  # of the folder
    folder: str  # path of the folder
    begun: float  # start, wall clock [s]
    duration: float  # [s]
    size: int  # [B]
    kept: bool  # marked to be kept
    written: bool  # being written
    instance: str  # in which it was recorded
    events: tuple[str, ...]  # in the finished pieces


def rows(instance: Instance, *, everywhere: bool = False) -> list[Row]:
    """The recordings of an instance, or of every instance in its home, the oldest first."""
    folders = [instance.bags]
    if everywhere and instance.folder.parent.is_dir():
        folders = [folder / "bags" for folder in sorted(instance.folder.parent.iterdir()) if folder.is_dir()]
    found = [_row(recording) for folder in folders for recording in recordings.look(folder)]
    return sorted(found, key=lambda row: (row.begun, row.name))


def _row(recording: recordings.Recording) -> Row:
    written = recording.written
    head = rosbag2_metadata.head(recording.folder)
    begun = head.start if head and head.messages else recording.begun
    if written:
        duration = max(0.0, time.time() - begun)
    else:
        duration = head.duration if head else max(0.0, recording.ended - begun)
    name = recording.folder.parent.parent.name
    with contextlib.suppress(OSError):
        name = origin(recording.files[0].path).get("instance", name)
    events = tuple(f"{when[11:19]} {what}" for when, what in head.events.items()) if head else ()
    return Row(
        recording.name, str(recording.folder), begun, duration, recording.size, recording.kept, written, name, events
    )
