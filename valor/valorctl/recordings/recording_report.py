"""What an instance records: bag, size, growth, and the time until bounds or disk are reached.

Names, sizes and times of files suffice; no process is queried.
"""

import contextlib
import math
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from valor.bags import recordings, retention
from valor.bags.files import is_own_folder
from valor.common.instance import Bounds, Instance, Settings
from valor.common.processes import RECORDER
from valor.valorctl.terminal.console import size_text, time_text

USUAL_RATE = 1e6  # of a recording of all topics in real time, until the rate can be measured [B/s]
_LEAST_MEASURED = 2.0  # duration for a measurement [s]


@dataclass(frozen=True)
class Glance:
    """State of the recordings of an instance."""

    path: Path | None  # the bag that is being written, or None
    size: int  # of all pieces of that bag [B]
    duration: float  # since its start [s]
    total: int  # size of all recordings in the instance's folder [B]
    limit: int | None  # of ``total`` [B]; None without a bound

    def line(self) -> str:
        """The line of `status`."""
        bound = "" if self.limit is None else f" of {size_text(self.limit)}"
        together = f"recordings take {size_text(self.total)}{bound}"
        if self.path is None:
            return f"nothing is being written; {together}"
        return f"recording to {_place(self.path)}: {size_text(self.size)}, {time_text(self.duration)}; {together}"

    def as_json(self) -> dict[str, Any]:
        """The object of `status --json`."""
        bag = None if self.path is None else str(self.path)
        sizes = {"total_bytes": self.total, "limit_bytes": self.limit}
        return {"bag": bag, "bytes": self.size, "seconds": self.duration, **sizes}


def glance(instance: Instance, bounds: Bounds) -> Glance:
    """The state of the recordings of an instance, up or down, and the bounds of its settings."""
    path = recordings.being_written(instance.folder)
    limit = bounds.limit(retention.disk_of(instance.bags).capacity)
    size, duration = (0, 0.0) if path is None else _extent(path, time.time())
    return Glance(path, size, duration, _total(instance), limit)


def _total(instance: Instance) -> int:
    return sum(each.size for each in recordings.look(instance.bags))


def _place(bag: Path) -> Path:
    return bag.parent if is_own_folder(bag) else bag


def _extent(bag: Path, end: float | None = None) -> tuple[int, float]:
    """Size of all pieces of a bag [B], and duration until ``end`` [wall clock, s]; None: its last modification."""
    found = []
    for piece in recordings.pieces_of(bag):
        with contextlib.suppress(OSError):  # removed at any time
            found.append((piece, piece.stat()))
    if not found:
        return 0, 0.0
    last = max(stat.st_mtime for _, stat in found) if end is None else end
    start = min(recordings.start_of(piece) for piece, _ in found)
    return sum(stat.st_size for _, stat in found), max(0.0, last - start)


@dataclass(frozen=True)
class Outlook:
    """Expected end of the space for recordings."""

    rate: float  # growth of the recordings [B/s]
    seconds: float  # until ``what``
    what: str  # what happens then
    free: int  # free space on the disk [B]
    limit: int | None  # of all recordings [B]; None without a bound
    short: bool = False  # the disk is full before the recordings reach their bounds

    def line(self) -> str:
        """The line of `up` and `doctor`."""
        until = f"in {time_text(self.seconds)} {self.what}" if self.seconds > 0 else self.what
        return f"{self.rate / 1e6:.1f} MB/s, {until}"


def outlook(instance: Instance, bounds: Bounds, bag: Path | None) -> Outlook:
    """The time until bounds or disk are reached, by the bag that is being written, or by a usual one (None)."""
    disk = retention.disk_of(instance.bags if bag is None else bag.parent)
    rate, limit = USUAL_RATE, bounds.limit(disk.capacity)
    size, duration = (0, 0.0) if bag is None else _extent(bag, time.time())
    if duration > _LEAST_MEASURED:
        rate = max(1.0, size / duration)
    if bag is not None and not bag.is_relative_to(instance.bags):
        return Outlook(rate, disk.free / rate, "the disk is full", disk.free, None, short=True)
    to_limit = math.inf if limit is None else max(0, limit - _total(instance))
    to_reserve = max(0, disk.free - disk.reserve)
    if limit is not None and to_limit <= to_reserve:
        what = f"recordings take {size_text(limit)} and the oldest is removed"
        return Outlook(rate, to_limit / rate, what, disk.free, limit)
    what = f"only {size_text(disk.reserve)} are free and the oldest is removed"
    return Outlook(rate, to_reserve / rate, what, disk.free, limit, short=True)


def announcement(instance: Instance, settings: Settings, processes: Iterable[str]) -> str:
    """The line of `up`: path, rate and outlook of the recording."""
    if RECORDER not in processes:
        return "nothing is recorded"
    if settings.recording.ring_seconds is not None:
        held = time_text(settings.recording.ring_seconds)
        return f"holding the last {held}; a fall or `valorctl bag snap` saves them in {settings.bag or instance.bags}"
    bag = recordings.being_written(instance.folder)
    if bag is None:
        return f"nothing is being recorded; `valorctl status` states why ({RECORDER})"
    return f"recording to {_place(bag)}: {outlook(instance, settings.recording.bounds, bag).line()}"


def summary(bag: Path) -> str:
    """The line of `down` about a bag that was being written."""
    size, duration = _extent(bag)
    return f"recorded {_place(bag)}: {size_text(size)}, {time_text(duration)}"
