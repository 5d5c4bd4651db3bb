"""The bags of a recorder, one after the other: where each goes, what stands in it beside messages, how it ends."""

from __future__ import annotations

import contextlib
import errno
import logging
import socket
import time
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path

import msgspec

from valor.bag_recorder import tally
from valor.bag_recorder.bag import Bag, RecordedTopic
from valor.bag_recorder.clock import WallClock
from valor.bag_recorder.housekeeper import Housekeeper
from valor.bags import recordings
from valor.bags.errors import BagError
from valor.bags.event import EVENT, Event
from valor.bags.files import SUFFIX
from valor.bags.index import read_index
from valor.bags.recordings import Unfinished
from valor.bags.recovery import recover
from valor.common import whole_file
from valor.common.errors import ConfigurationError
from valor.common.table import plain
from valor.service import Context

MARK = "mark"  # an event that somebody noted
SPACE_KEPT = 64 << 20  # the disk is never filled beyond this [B]

_log = logging.getLogger("bag_recorder")


class Shelf:
    """Begins and finishes bags, and gives each its metadata.

    Args:
        context: of the recorder.
        clock: by which it stamps.
        counts: what was received and dropped since start, by topic.

    Raises:
        ConfigurationError: the settings name no place for a bag.
    """

    def __init__(self, context: Context, clock: WallClock, counts: Callable[[], Mapping[str, tuple[int, int]]]) -> None:
        self._context, self._clock, self._counts = context, clock, counts
        self._notes = _Notes(context.instance.folder)
        self._tally = tally.Tally()
        self._latched: dict[RecordedTopic, tuple[int, int, bytes]] = {}
        self._folder = self._recording_folder()
        recovered = self._notes.recover_unfinished()
        self._silent_since = self._end_of(recovered)
        self._keeper = Housekeeper(context.instance.bags, context.settings.recording.bounds, recovered)

    def place(self, label: str = "") -> Path:
        """Where the settings want the next bag: in the file that they name, else in a folder of its own name.

        Bags without a label are one recording and share their folder; one with a label is a recording by itself.
        """
        wanted = self._context.settings.bag
        if wanted is not None and wanted.suffix == SUFFIX:
            return wanted.with_stem(f"{wanted.stem}_{label}") if label else wanted
        folder = self._folder
        if label:
            name = folder.name if folder == wanted else recordings.name_of(datetime.now())
            folder = _unused(folder.with_name(f"{name}_{label}"))
        return folder / f"{folder.name}{SUFFIX}"

    def _recording_folder(self) -> Path:
        """The named folder, also when a recorder before this one has begun it; in a folder of bags one by the time."""
        wanted = self._context.settings.bag
        if wanted is None or (wanted.is_dir() and not (wanted / f"{wanted.name}{SUFFIX}").exists()):
            return _unused((wanted or self._context.instance.bags) / recordings.name_of(datetime.now()))
        if wanted.suffix not in ("", SUFFIX):
            raise ConfigurationError(f"bag: {wanted}: expected a folder or a name that ends in {SUFFIX}")
        return wanted

    def remember(self, topic: RecordedTopic, publish_time: int, sequence: int, data: bytes) -> None:
        """Keep the last message of a latched topic for the bags to come."""
        self._latched[topic] = (publish_time, sequence, data)

    def begin(self, label: str = "") -> Bag:
        """A new bag that holds where it comes from.

        Raises:
            OSError: it cannot be written.
        """
        path = _unused(self.place(label))
        bag = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self.check_space(path.parent)
            self._keep_if_named(path.parent)
            bag = Bag(path)
            self._notes.begun(path)
            bag.add_metadata("valor", self._origin())
            self._note_gap(bag)
        except OSError as error:
            error.filename = error.filename or str(path)
            if bag is not None:  # an empty bag at every try would be no help
                bag.abandon()
                path.unlink(missing_ok=True)
                with contextlib.suppress(OSError):
                    self._notes.finished(path)
            raise
        return bag

    def add_latched(self, bag: Bag, log_time: int, but: frozenset[str] = frozenset()) -> None:
        """Begin a bag with what late-comers still get: the last messages of latched topics, but for some.

        Raises:
            OSError: it cannot be written.
        """
        for topic, (publish_time, sequence, data) in self._latched.items():
            if topic.name not in but:
                bag.write(topic, log_time, publish_time, sequence, data)

    def finish(self, bag: Bag) -> None:
        """Add what became of each topic and of the clock, and close the bag.

        Raises:
            OSError: it cannot be written.
        """
        received = self._counts()
        bag.add_metadata("topics", tally.metadata(self._tally.share(received, bag.written)))
        bag.add_metadata("clock", self._clock.metadata())
        bag.close()
        self._tally.settle(received, bag.written)
        self._notes.finished(bag.path)
        self._keeper.finished(bag.path)
        _log.info("%s: finished with %d messages", bag.path, bag.messages)

    def give_up(self, bag: Bag, error: OSError) -> str:
        """Writing failed: save what is written. Returns why, in one line."""
        bag.abandon()
        self._tally.settle(self._counts(), bag.written)
        reason = told(error, bag.path)
        _log.error("stopped recording: %s", reason)
        try:
            recover(bag.path)
            self._notes.finished(bag.path)
            self._keeper.finished(bag.path)
        except (BagError, OSError) as failed:
            _log.error("left to be finished later: %s", failed)
        return reason

    def recover_unfinished(self) -> None:
        """Finish what could not be finished before."""
        for path in self._notes.recover_unfinished():
            self._keeper.finished(path)

    def close(self) -> None:
        """See that rosbag2 knows of all that is finished."""
        self._keeper.close()

    def event(self, bag: Bag, what: str, stamp: int, reason: str) -> None:
        """Write into a bag what happened, and when [ns, wall clock].

        Raises:
            OSError: it cannot be written.
        """
        bag.add_metadata(EVENT, Event(stamp, what, reason).record())

    def _end_of(self, recovered: list[Path]) -> int:
        """When a recorder before this one, since `up`, wrote its last message [ns, wall clock]; 0: there was none."""
        ends = [index.statistics.message_end_time for bag in recovered if (index := read_index(bag)) is not None]
        last = max(ends, default=0)
        return last if last > self._context.settings.epoch + self._clock.offset else 0

    def _note_gap(self, bag: Bag) -> None:
        """How long nobody recorded, and so nobody counted: in the first bag after a crash."""
        if self._silent_since:
            gap = f"nothing was recorded for {1e-9 * (wall_time(self._clock) - self._silent_since):.1f} s"
            _log.warning("%s: a recorder has ended before its time", gap)
            self.event(bag, "gap", self._silent_since, gap)
            self._silent_since = 0

    def _keep_if_named(self, folder: Path) -> None:
        """Where somebody said where to record, that stays, even by a name and in a place as of ours."""
        if self._context.settings.bag == folder and folder.parent == self._context.instance.bags:
            (folder / recordings.KEEP).touch()

    def check_space(self, folder: Path) -> None:
        """See that the disk is not full.

        Raises:
            OSError: it nearly is.
        """
        if recordings.disk_of(folder).free < SPACE_KEPT:
            raise OSError(errno.ENOSPC, f"less than {SPACE_KEPT >> 20} MiB are left on the disk", str(folder))

    def tell(self) -> None:
        """Print what became of each topic since start."""
        self._tally.settle(self._counts(), {})
        for line in tally.table(self._tally.total):
            _log.info("%s", line)

    def _origin(self) -> dict[str, str]:
        """Where the bag comes from: enough to repeat what it shows, and to turn its times into monotonic ones."""
        settings, robot = self._context.settings, self._context.robot
        return {
            "instance": self._context.instance.name,
            "computer": socket.gethostname(),
            "robot": robot.name,
            "robot_folder": str(settings.robot),
            "joints": " ".join(robot.joints),
            "profile": settings.profile,
            "clock": settings.clock,
            "actuators": settings.actuators,
            "seed": str(settings.seed),
            "world": settings.world,
            "started": datetime.now().astimezone().isoformat(),
            "wall_minus_monotonic_ns": str(self._clock.offset),
            "wall_clock_drift_ns": str(self._clock.drift),
        }


class _Notes:
    """A file in the instance's folder that names the bags not finished yet."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._file = folder, recordings.notes_file(folder)

    def recover_unfinished(self) -> list[Path]:
        """Finish what an earlier run of this instance left; returns what is finished now."""
        finished, left = [], []
        for path in recordings.unfinished(self._folder):
            try:
                found = recover(path)
                finished.append(path)
                _log.info("%s: recovered, %d messages", path, found.messages)
            except BagError as error:
                _log.warning("not recovered: %s", error)
                left += [path] if path.exists() else []  # on a full disk it cannot be; there will be room again
        with contextlib.suppress(OSError):
            self._write(left)
        return finished

    def begun(self, path: Path) -> None:
        self._write([*recordings.unfinished(self._folder), path])

    def finished(self, path: Path) -> None:
        self._write([each for each in recordings.unfinished(self._folder) if each != path])

    def _write(self, paths: list[Path]) -> None:
        if not paths:
            self._file.unlink(missing_ok=True)
            return
        whole_file.write(self._file, msgspec.json.encode(plain(Unfinished(unfinished=tuple(paths)))))


def wall_time(clock: WallClock) -> int:
    """Now, on the axis of the bag [ns]."""
    return time.monotonic_ns() + clock.offset


def told(error: OSError, path: Path) -> str:
    """What went wrong with which file, in one line."""
    return f"{error.filename or path}: {error.strerror or error}"


def _unused(path: Path) -> Path:
    """The path, or with a number where something stands already: no bag is ever overwritten."""
    candidate, number = path, 0
    while candidate.exists():
        number += 1
        candidate = path.with_stem(f"{path.stem}_{number}")
    return candidate
