"""The bags of a recorder: path, start and end of each, recovery of unfinished bags, metadata."""

import contextlib
import errno
import json
import logging
import queue
import socket
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from pathlib import Path

import msgspec

from valor.bag_recorder.bag import Bag, RecordedTopic
from valor.bag_recorder.clock import StampConverter
from valor.bags import recordings, retention, rosbag2_metadata
from valor.bags.errors import BagError
from valor.bags.files import SUFFIX, is_own_folder
from valor.bags.index import read_index
from valor.bags.recordings import Unfinished
from valor.bags.recovery import recover
from valor.bags.rosbag2_metadata import EVENT
from valor.common import whole_file
from valor.common.behaviors import Behavior
from valor.common.errors import ConfigurationError
from valor.common.instance import Bounds
from valor.common.table import plain
from valor.service import Context

PERIOD = 10.0  # between checks of the bounds; a finished bag causes a check at once [s]
CLOSE_TIMEOUT = 5.0  # [s]

_log = logging.getLogger("bag_recorder")
FALL = Behavior.FALL  # an event, and the label of a bag that was saved for it
MARK = "mark"  # an event noted by a client
SPACE_KEPT = 64 << 20  # free space that the recorder leaves on the disk [B]


class Housekeeper:
    """Thread that describes finished bags for rosbag2 and keeps all recordings of a folder within bounds.

    The recorder does not wait for it: removing 4 GB from a slow disk delays only this thread.
    """

    def __init__(self, bags: Path, bounds: Bounds, finished: Iterable[Path] = ()) -> None:
        self._bags, self._bounds = bags, bounds
        # Ages are measured by a clock that cannot be set: a jump by a month would remove every recording.
        self._offset = time.time() - time.monotonic()
        self._floor = sum(recording.size for recording in recordings.look(bags))
        self._finished: queue.Queue[Path | None] = queue.Queue()
        for bag in finished:
            self._finished.put(bag)
        self._logged = ""
        self._thread = threading.Thread(target=self._run, name="housekeeper", daemon=True)
        self._thread.start()

    def finished(self, bag: Path) -> None:
        self._finished.put(bag)

    def close(self) -> None:
        self._finished.put(None)
        self._thread.join(CLOSE_TIMEOUT)

    def _run(self) -> None:
        self._prune()
        while True:
            try:
                bag = self._finished.get(timeout=PERIOD)
                if bag is None:
                    return
                self._describe(bag)
            except queue.Empty:
                pass
            self._prune()

    def _describe(self, bag: Path) -> None:
        if not is_own_folder(bag):
            return
        here = bag.parent.parent == self._bags
        try:
            with retention.changing(self._bags) if here else contextlib.nullcontext():
                rosbag2_metadata.write(bag.parent)
        except OSError as error:
            self._warn(f"{error.filename or bag}: {error.strerror}: {rosbag2_metadata.FILE} not updated")

    def _prune(self) -> None:
        try:
            removed = retention.prune(self._bags, self._bounds, floor=self._floor, now=time.monotonic() + self._offset)
        except OSError as error:
            self._warn(f"{error.filename or self._bags}: {error.strerror}: recordings exceed their bounds")
            return
        for each in removed:
            _log.info("%s: removed, %.1f MB: %s", each.piece.path, each.piece.size / 1e6, each.why)

    def _warn(self, what: str) -> None:
        if what != self._logged:
            self._logged = what
            _log.warning("%s", what)


class BagStore:
    """Starts and finishes bags; ``counts``: messages received and dropped since the recorder's start, by topic.

    Raises:
        ConfigurationError: by the constructor: the settings name no valid path for a bag.
        OSError: by the other methods: the bag cannot be written.
    """

    def __init__(
        self, context: Context, clock: StampConverter, counts: Callable[[], Mapping[str, tuple[int, int]]]
    ) -> None:
        self._context, self._clock, self._counts = context, clock, counts
        self._reported: dict[str, tuple[int, int]] = {}  # counts that the metadata of finished bags includes
        self._latched: dict[RecordedTopic, tuple[int, int, bytes]] = {}
        self._folder = self._recording_folder()
        recovered = self._recover()
        self._silent_since = self._end_of(recovered)
        self._keeper = Housekeeper(context.instance.bags, context.settings.recording.bounds, recovered)

    def path(self, label: str = "") -> Path:
        """Path of the next bag: the configured file, or a file in a folder of its own name.

        Bags without a label share a folder; a bag with a label is a recording by itself.
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
        """The configured folder, also if an earlier recorder started it; in a folder of bags, one named by the time."""
        wanted = self._context.settings.bag
        if wanted is None or (wanted.is_dir() and not (wanted / f"{wanted.name}{SUFFIX}").exists()):
            return _unused((wanted or self._context.instance.bags) / recordings.name_of(datetime.now()))
        if wanted.suffix not in ("", SUFFIX):
            raise ConfigurationError(f"bag: {wanted}: expected a folder or a name that ends in {SUFFIX}")
        return wanted

    def remember(self, topic: RecordedTopic, publish_time: int, sequence: int, data: bytes) -> None:
        self._latched[topic] = (publish_time, sequence, data)

    def begin(self, label: str = "") -> Bag:
        path = _unused(self.path(label))
        bag = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self.check_space(path.parent)
            if self._context.settings.bag == path.parent and path.parent.parent == self._context.instance.bags:
                (path.parent / recordings.KEEP).touch()  # a recording named by its user stays
            bag = Bag(path)
            self._note([*self._noted(), path])
            bag.add_metadata("valor", self._origin())
            self._add_gap(bag)
        except OSError as error:
            error.filename = error.filename or str(path)
            if bag is not None:  # do not leave an empty bag at every attempt
                bag.abandon()
                path.unlink(missing_ok=True)
                with contextlib.suppress(OSError):
                    self._forget(path)
            raise
        return bag

    def add_latched(self, bag: Bag, log_time: int, but: frozenset[str] = frozenset()) -> None:
        """Write the last messages of latched topics, except of some, at the start of a bag."""
        for topic, (publish_time, sequence, data) in self._latched.items():
            if topic.name not in but:
                bag.write(topic, log_time, publish_time, sequence, data)

    def add_event(self, bag: Bag, what: str, stamp: int, reason: str) -> None:
        """Write an event at a time [ns, wall clock] into a bag."""
        bag.add_metadata(EVENT, {"what": what, "stamp_ns": str(stamp), "reason": reason})

    def finish(self, bag: Bag) -> None:
        """Add message counts and clock drift, and close the bag."""
        counts = dict(self._counts())
        bag.add_metadata("topics", topic_counts(counts, self._reported, bag.written))
        bag.add_metadata("clock", self._clock.metadata())
        bag.close()
        self._reported = counts
        self._finished(bag.path)
        _log.info("%s: finished with %d messages", bag.path, bag.messages)

    def rescue(self, bag: Bag, error: OSError) -> str:
        """Save the written part of a bag that cannot be written any more; returns the reason in one line."""
        bag.abandon()
        self._reported = dict(self._counts())
        reason = one_line(error, bag.path)
        _log.error("stopped recording: %s", reason)
        try:
            recover(bag.path)
            self._finished(bag.path)
        except (BagError, OSError) as failed:
            _log.error("left to be finished later: %s", failed)
        return reason

    def recover_unfinished(self) -> None:
        for path in self._recover():
            self._keeper.finished(path)

    def check_space(self, folder: Path) -> None:
        """Raise ``OSError`` if the disk is nearly full."""
        if retention.disk_of(folder).free < SPACE_KEPT:
            raise OSError(errno.ENOSPC, f"less than {SPACE_KEPT >> 20} MiB are left on the disk", str(folder))

    def close(self) -> None:
        """Wait until all finished bags have their ``metadata.yaml``."""
        self._keeper.close()

    def _end_of(self, recovered: list[Path]) -> int:
        """Last message of earlier recorders since `up` [ns, wall clock]; 0 without one."""
        ends = [index.statistics.message_end_time for bag in recovered if (index := read_index(bag)) is not None]
        last = max(ends, default=0)
        return last if last > self._context.settings.epoch + self._clock.offset else 0

    def _add_gap(self, bag: Bag) -> None:
        if self._silent_since:
            gap = f"nothing was recorded for {1e-9 * (wall_time(self._clock) - self._silent_since):.1f} s"
            _log.warning("%s: an earlier recorder ended unexpectedly", gap)
            self.add_event(bag, "gap", self._silent_since, gap)
            self._silent_since = 0

    def _origin(self) -> dict[str, str]:
        """The origin of a bag: enough to repeat the run, and to convert its times into monotonic ones."""
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

    def _finished(self, path: Path) -> None:
        self._forget(path)
        self._keeper.finished(path)

    def _recover(self) -> list[Path]:
        """Finish the bags that an earlier recorder of this instance left; returns those that are finished now."""
        finished, left = [], []
        for path in self._noted():
            try:
                found = recover(path)
                finished.append(path)
                _log.info("%s: recovered, %d messages", path, found.messages)
            except BagError as error:
                _log.warning("not recovered: %s", error)
                left += [path] if path.exists() else []  # retried once a full disk has space again
        with contextlib.suppress(OSError):
            self._note(left)
        return finished

    def _noted(self) -> list[Path]:
        return recordings.unfinished(self._context.instance.folder)

    def _forget(self, path: Path) -> None:
        self._note([each for each in self._noted() if each != path])

    def _note(self, paths: list[Path]) -> None:
        file = recordings.notes_file(self._context.instance.folder)
        if paths:
            whole_file.write(file, msgspec.json.encode(plain(Unfinished(unfinished=tuple(paths)))))
        else:
            file.unlink(missing_ok=True)


def topic_counts(
    now: Mapping[str, tuple[int, int]], before: Mapping[str, tuple[int, int]], written: Mapping[str, int]
) -> dict[str, str]:
    """Messages of a bag by topic, as metadata: received, dropped (lost, invalid or without a bag), written.

    The topic's ``record_every`` excludes messages that are neither. ``now`` and ``before`` (at the end of the previous
    bag): messages received and dropped since the recorder's start.
    """
    topics = {}
    for name in sorted(now.keys() | written.keys()):
        earlier = before.get(name, (0, 0))
        received, dropped = now.get(name, earlier)
        count = {"received": received - earlier[0], "dropped": dropped - earlier[1], "written": written.get(name, 0)}
        topics[name] = json.dumps(count)
    return topics


def wall_time(clock: StampConverter) -> int:
    """The current time on the time axis of the bag [ns]."""
    return time.monotonic_ns() + clock.offset


def one_line(error: OSError, path: Path) -> str:
    """File and reason of an error in one line."""
    return f"{error.filename or path}: {error.strerror or error}"


def _unused(path: Path) -> Path:
    """The path, with a number if it exists: no bag is overwritten."""
    candidate, number = path, 0
    while candidate.exists():
        number += 1
        candidate = path.with_stem(f"{path.stem}_{number}")
    return candidate
