"""What a recording holds, from its index."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from valor.bags.errors import BagError
from valor.bags.files import SUFFIX
from valor.bags.index import BagIndex, read_index
from valor.common.errors import ValorError


@dataclass(frozen=True)
class RecordedTopic:
    """One topic of a recording."""

    name: str
    type: str
    messages: int
    rate: float  # over the whole recording [Hz]


@dataclass(frozen=True)
class BagSummary:
    """A recording at a glance."""

    file: Path
    size: int  # [B]
    start: float  # wall clock [s]
    duration: float  # [s]
    messages: int
    topics: list[RecordedTopic]

    def as_json(self) -> dict[str, Any]:
        """The object of ``bag info --json``."""
        return asdict(self) | {"file": str(self.file)}


def find(path: Path) -> list[Path]:
    """The recordings under a path: itself, or the folders below it that hold bags, in the order of their names.

    Raises:
        ValorError: there is none.
    """
    if not path.is_dir() or any(path.glob(f"*{SUFFIX}")):
        return [path]
    found = sorted({file.parent for file in path.rglob(f"*{SUFFIX}")})
    if not found:
        raise ValorError(f"{path}: no bag: expected files *{SUFFIX}, here or in folders below")
    return found


def summarize(path: Path) -> BagSummary:
    """Read the index of a recording: a file, or a folder of them.

    Raises:
        ValorError: no such file, no MCAP file, or one that has no index yet.
    """
    files = sorted(path.glob(f"*{SUFFIX}")) if path.is_dir() else [path]
    if not files:
        raise ValorError(f"{path}: no bag: expected files *{SUFFIX}")
    counts: dict[tuple[str, str], int] = {}
    starts, ends, messages = [], [], 0
    for file in files:
        index = _index(file)
        summary, statistics = index.summary, index.statistics
        messages += statistics.message_count
        if statistics.message_count:
            starts.append(statistics.message_start_time)
            ends.append(statistics.message_end_time)
        for channel in summary.channels.values():
            schema = summary.schemas.get(channel.schema_id)
            key = (channel.topic, schema.name if schema else "")
            counts[key] = counts.get(key, 0) + statistics.channel_message_counts.get(channel.id, 0)
    start = min(starts, default=0)
    duration = (max(ends, default=0) - start) * 1e-9
    topics = [
        RecordedTopic(name, type_name, count, count / duration if duration else 0.0)
        for (name, type_name), count in sorted(counts.items())
    ]
    return BagSummary(path, sum(file.stat().st_size for file in files), start * 1e-9, duration, messages, topics)


def _index(file: Path) -> BagIndex:
    try:
        index = read_index(file)
    except OSError as error:
        raise ValorError(f"{file}: {error.strerror}") from None
    except BagError as error:
        raise ValorError(f"{error}; `valorctl bag recover` finishes one that was cut off") from None
    if index is None:
        raise ValorError(f"{file}: has no index; `valorctl bag recover` adds it once the recorder has ended")
    return index
