"""What a recording holds, from its index."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader

from valor_common.errors import ValorError


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


def summarize(file: Path) -> BagSummary:
    """Read a recording's index.

    Raises:
        ValorError: no such file, no MCAP file, or one that has no index yet.
    """
    try:
        with open(file, "rb") as stream:
            summary = make_reader(stream).get_summary()
            size = file.stat().st_size
    except OSError as error:
        raise ValorError(f"{file}: {error.strerror}") from None
    except (McapError, ValueError) as error:
        raise ValorError(f"{file}: not a whole MCAP file ({error}); `valorctl bag recover` may mend it") from None
    if summary is None or summary.statistics is None:
        raise ValorError(f"{file}: has no index; `valorctl bag recover` adds it once the recorder has ended")
    statistics = summary.statistics
    duration = (statistics.message_end_time - statistics.message_start_time) * 1e-9
    topics = [
        RecordedTopic(
            channel.topic,
            summary.schemas[channel.schema_id].name if channel.schema_id in summary.schemas else "",
            (count := statistics.channel_message_counts.get(channel.id, 0)),
            count / duration if duration else 0.0,
        )
        for channel in summary.channels.values()
    ]
    return BagSummary(
        file,
        size,
        statistics.message_start_time * 1e-9,
        duration,
        statistics.message_count,
        sorted(topics, key=lambda topic: topic.name),
    )
