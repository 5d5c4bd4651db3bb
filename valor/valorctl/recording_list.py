"""The recordings of one instance, or of all in a home, as ``bag list`` shows them."""

from __future__ import annotations

import contextlib
import time
from dataclasses import asdict, dataclass
from typing import Any

from valor.bags import recordings, rosbag2_metadata
from valor.bags.files import origin
from valor.common.instance import Instance


@dataclass(frozen=True)
class Row:
    """One recording."""

    name: str
    folder: str
    begun: float  # wall clock [s]
    duration: float  # [s]
    size: int  # [B]
    kept: bool
    written: bool  # it is being written
    instance: str  # in which it was recorded
    events: tuple[str, ...]  # as far as they are known: once a piece is finished

    def as_json(self) -> dict[str, Any]:
        """The object of ``bag list --json``."""
        return asdict(self)


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
        name = origin(recording.files[0][0]).get("instance", name)
    events = tuple(f"{when[11:19]} {what}" for when, what in head.events.items()) if head else ()
    return Row(
        recording.name, str(recording.folder), begun, duration, recording.size, recording.kept, written, name, events
    )
