"""What a system records: where, how fast, how much, until when. Told by names, sizes and times of files alone."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from valor.bags import recordings
from valor.bags.files import SUFFIX, is_own_folder
from valor.common.bounds import Bounds
from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.common.processes import RECORDER
from valor.valorctl.amounts import size_text, time_text

USUAL_RATE = 1e6  # of everything, in real time; until there is enough to measure [B/s]
_LEAST_MEASURED = 2.0  # [s]


@dataclass(frozen=True)
class Glance:
    """One look at what is recorded.

    Attributes:
        path: the bag that is being written; None: none is.
        size: of all its pieces so far [B].
        duration: since it began [s].
        total: of all recordings in the instance's folder [B].
        limit: what these may take [B]; None: what the disk takes.
    """

    path: Path | None
    size: int
    duration: float
    total: int
    limit: int | None

    def line(self) -> str:
        """For `status`."""
        bound = "" if self.limit is None else f" of {size_text(self.limit)}"
        together = f"recordings take {size_text(self.total)}{bound}"
        if self.path is None:
            return f"nothing is being written; {together}"
        name = self.path.parent if is_own_folder(self.path) else self.path
        return f"recording to {name}: {size_text(self.size)}, {time_text(self.duration)}; {together}"

    def as_json(self) -> dict[str, Any]:
        """For `status --json`."""
        return {
            "bag": None if self.path is None else str(self.path),
            "bytes": self.size,
            "seconds": self.duration,
            "total_bytes": self.total,
            "limit_bytes": self.limit,
        }


def glance(instance: Instance, bounds: Bounds) -> Glance:
    """Look; takes a millisecond or so for a hundred recordings.

    Args:
        instance: up or down.
        bounds: of its recordings (``Settings.recording.bounds``).
    """
    total = sum(each.size for each in recordings.look(instance.bags))
    limit = bounds.limit(recordings.disk_of(instance.bags).capacity)
    path = recordings.being_written(instance.folder)
    if path is None:
        return Glance(None, 0, 0.0, total, limit)
    pieces = recordings.pieces_of(path)
    begun = min((recordings.start_of(piece) for piece in pieces), default=time.time())
    return Glance(path, sum(_size(piece) for piece in pieces), max(0.0, time.time() - begun), total, limit)


def _size(file: Path) -> int:
    """Of a file that may go at any time [B]."""
    try:
        return file.stat().st_size
    except OSError:
        return 0


def rate(bag: Path | None) -> float:
    """How fast a bag that is being written grows [B/s]; the usual, while there is little to measure."""
    if bag is None:
        return USUAL_RATE
    duration = time.time() - recordings.start_of(bag)
    return _size(bag) / duration if duration > _LEAST_MEASURED else USUAL_RATE


@dataclass(frozen=True)
class Outlook:
    """How recording will go on.

    Attributes:
        rate: at which recordings grow [B/s].
        seconds: until something gives way.
        what: gives way then.
        free: on the disk now [B].
        bounded: whether bounds hold where it is recorded.
        short: whether the disk is full before the recordings have reached their bounds.
    """

    rate: float
    seconds: float
    what: str
    free: int
    bounded: bool = True
    short: bool = False

    def line(self) -> str:
        """For `up` and `doctor`."""
        until = f"in {time_text(self.seconds)} {self.what}" if self.seconds > 0 else self.what
        return f"{self.rate / 1e6:.1f} MB/s, {until}"


def outlook(instance: Instance, bounds: Bounds, bag: Path | None) -> Outlook:
    """How long until the bounds or the disk are reached, and what then.

    Args:
        instance: whose recordings.
        bounds: of these.
        bag: that is being written; None: one as usual will be.
    """
    bounded = bag is None or bag.is_relative_to(instance.bags)
    disk = recordings.disk_of(instance.bags if bag is None else bag.parent)
    speed = max(1.0, rate(bag))
    if not bounded:
        return Outlook(speed, disk.free / speed, "the disk is full", disk.free, bounded=False, short=True)
    total = sum(each.size for each in recordings.look(instance.bags))
    limit = bounds.limit(disk.capacity)
    to_limit = math.inf if limit is None else max(0, limit - total)
    to_reserve = max(0, disk.free - disk.reserve)
    if limit is not None and to_limit <= to_reserve:
        return Outlook(speed, to_limit / speed, f"recordings take {size_text(limit)} and the oldest go", disk.free)
    return Outlook(
        speed, to_reserve / speed, f"only {size_text(disk.reserve)} are free and the oldest go", disk.free, short=True
    )


def prospect(instance: Instance) -> tuple[Outlook, str]:
    """For `doctor`: how recording goes on, or would; and what recordings may take.

    Raises:
        ValorError: settings or bounds are not readable.
    """
    up = instance.settings_file.exists()
    bounds = instance.settings().recording.bounds if up else recordings.saved_bounds(instance.bags)
    limit = bounds.limit(recordings.disk_of(instance.bags).capacity)
    bag = recordings.being_written(instance.folder) if up else None
    return outlook(instance, bounds, bag), "as much as there is" if limit is None else size_text(limit)


def announcement(instance: Instance, settings: Settings, processes: Iterable[str]) -> str:
    """For `up`: where it records, how fast that grows, and until when."""
    if RECORDER not in processes:
        return "nothing is recorded"
    if settings.recording.ring_seconds is not None:
        held = time_text(settings.recording.ring_seconds)
        return f"holding the last {held}; a fall or `valorctl bag snap` saves them in {settings.bag or instance.bags}"
    bag = recordings.being_written(instance.folder)
    if bag is None:
        return f"nothing is being recorded; `valorctl status` says why ({RECORDER})"
    ahead = outlook(instance, settings.recording.bounds, bag)
    place = bag.parent if is_own_folder(bag) else bag
    return f"recording to {place}: {ahead.line()}"


@dataclass(frozen=True)
class Written:
    """A recording that has ended."""

    path: Path
    size: int  # [B]
    duration: float  # [s]

    def line(self) -> str:
        """For `down`."""
        return f"recorded {self.path}: {size_text(self.size)}, {time_text(self.duration)}"


def up_since(instance: Instance) -> Callable[[], list[Written]]:
    """Asked while an instance is up, gives what tells once it is down what was recorded since `up`, oldest first."""
    try:
        settings, since = instance.settings(), instance.settings_file.stat().st_mtime
    except (ValorError, OSError):  # not up
        return lambda: []
    return lambda: _written(instance, settings, since)


def _written(instance: Instance, settings: Settings, since: float) -> list[Written]:
    from valor.bags.rosbag2_metadata import head as head_of

    found = []
    for recording in recordings.look(instance.bags):
        if min(recording.begun + 1.0, recording.ended) >= since:  # its name tells whole seconds
            head = head_of(recording.folder)
            duration = head.duration if head else recording.ended - recording.begun
            found.append(Written(recording.folder, recording.size, duration))
    if settings.bag is not None and all(each.path != settings.bag for each in found):
        found += _named(settings.bag, since)
    return found


def _named(bag: Path, since: float) -> list[Written]:
    """Recordings where somebody wanted them: a folder, or files of that name."""
    from valor.bags.rosbag2_metadata import head as head_of

    if bag.suffix != SUFFIX:
        head = head_of(bag)
        size = sum(_size(piece) for piece in recordings.pieces_of(bag / f"{bag.name}{SUFFIX}"))
        return [Written(bag, size, head.duration if head else 0.0)] if size else []
    found = [(file, file.stat()) for file in sorted(bag.parent.glob(f"{bag.stem}*{bag.suffix}"))]
    return [
        Written(file, stat.st_size, max(0.0, stat.st_mtime - recordings.start_of(file)))
        for file, stat in found
        if stat.st_mtime >= since
    ]
