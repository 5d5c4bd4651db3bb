"""The recorder's loop: some fifty times a second move what has come from both sides into the bag."""

from __future__ import annotations

import json
import logging
import os
import shutil
import socket
import time
from datetime import datetime
from pathlib import Path

from bag_recorder.bag import Bag
from bag_recorder.bifrost_tap import BifrostTap
from bag_recorder.clock import WallClock
from bag_recorder.definitions import UnknownTypeError
from bag_recorder.ros_tap import RosTap
from valor_common.bag_recovery import BagError, recover
from valor_common.errors import ConfigurationError
from valor_common.service import Context, quiet_collector

PERIOD = 0.02  # between two looks [s]
FLUSH_PERIOD = 0.5  # what SIGKILL may lose [s]
DISCOVERY_PERIOD = 0.25  # [s]
CLOCK_PERIOD = 1.0  # [s]
RETRY_PERIOD = 5.0  # after a bag could not be written [s]
SPACE_KEPT = 64 << 20  # the disk is never filled beyond this [B]
SUFFIX = ".mcap"

_log = logging.getLogger("bag_recorder")


class BagRecorder:
    """The service. One thread does everything but receiving, which ZeroMQ and Fast DDS do in threads of their own.

    Raises:
        ConfigurationError: no bag can be written where the settings say.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._statistics = context.statistics
        self._notes = _Notes(context.instance.folder / "bag_recorder.json")
        _place(context)
        self._notes.recover_unfinished()
        self._clock = WallClock()
        self._bag: Bag | None = None
        self._unwritten = 0
        context.statistics.state("starting", "subscribing")
        try:
            self._bifrost = BifrostTap(context.node, self._clock)
        except UnknownTypeError as error:
            raise ConfigurationError(f"{error}; expected the packages of `make setup`") from None
        self._ros = RosTap(context.settings.ros_domain_id)
        try:
            self._open()
        except (OSError, ConfigurationError) as error:
            self._ros.close()
            if isinstance(error, OSError):
                raise ConfigurationError(_told(error, _place(context))) from None
            raise

    def run(self) -> None:
        """Record until told to stop."""
        self._ros.discover()
        quiet_collector()
        self._statistics.state("ready")
        now = time.monotonic()
        next_flush, next_discovery, next_clock = now + FLUSH_PERIOD, now + DISCOVERY_PERIOD, now + CLOCK_PERIOD
        next_try = now
        while not self._context.stopping.wait(PERIOD):
            now = time.monotonic()
            if now >= next_discovery:
                next_discovery = now + DISCOVERY_PERIOD
                self._ros.discover()
            if self._bag is None and now >= next_try:
                next_try = now + RETRY_PERIOD
                self._try_again()
            try:
                self._drain()
                if self._bag is not None and now >= next_flush:
                    next_flush = now + FLUSH_PERIOD
                    self._bag.flush()
                if now >= next_clock:
                    next_clock = now + CLOCK_PERIOD
                    self._check_clock()
                    self._check_space()
            except OSError as error:
                self._give_up(error)
                next_try = now + RETRY_PERIOD
            self._statistics.drops = self._bifrost.drops + self._unwritten
            self._statistics.idle()

    def close(self) -> None:
        """Take what still waits, finish the bag and leave both sides."""
        bag = self._bag
        if bag is not None:
            try:
                self._drain()
                bag.close()
                self._notes.finished(bag.path)
                _log.info("%s: finished with %d messages", bag.path, bag.messages)
            except OSError as error:
                self._give_up(error)
        self._ros.close()

    def _drain(self) -> None:
        count = self._bifrost.drain(self._bag) + self._ros.drain(self._bag)
        if self._bag is None:
            self._unwritten += count

    def _open(self) -> None:
        """Begin a new bag.

        Raises:
            OSError: it cannot be written.
            ConfigurationError: the settings name no place for a bag.
        """
        path = _unused(_place(self._context))
        path.parent.mkdir(parents=True, exist_ok=True)
        bag = Bag(path)
        self._notes.begun(path)
        bag.add_metadata("valor", self._origin())
        self._bag = bag
        _log.info("recording to %s", path)

    def _origin(self) -> dict[str, str]:
        """Where the bag comes from: enough to repeat what it shows, and to turn its times into monotonic ones."""
        settings = self._context.settings
        return {
            "instance": self._context.instance.name,
            "computer": socket.gethostname(),
            "robot": self._context.robot.name,
            "profile": settings.profile,
            "clock": settings.clock,
            "actuators": settings.actuators,
            "seed": str(settings.seed),
            "world": settings.world,
            "started": datetime.now().astimezone().isoformat(),
            "wall_minus_monotonic_ns": str(self._clock.offset),
        }

    def _check_clock(self) -> None:
        if self._clock.check():
            _log.warning("the wall clock has moved %.6f s against the monotonic one", self._clock.drift / 1e9)
            if self._bag is not None:
                self._bag.add_metadata(
                    "clock_drift",
                    {"monotonic_ns": str(time.monotonic_ns()), "drift_ns": str(self._clock.drift)},
                )

    def _check_space(self) -> None:
        if self._bag is not None and shutil.disk_usage(self._bag.path.parent).free < SPACE_KEPT:
            raise OSError(None, f"less than {SPACE_KEPT >> 20} MiB are left on the disk")

    def _give_up(self, error: OSError) -> None:
        """Writing failed: save what is written, tell why, go on without a bag."""
        bag, self._bag = self._bag, None
        assert bag is not None
        bag.abandon()
        reason = _told(error, bag.path)
        _log.error("stopped recording: %s", reason)
        try:
            recover(bag.path)
            self._notes.finished(bag.path)
        except (BagError, OSError) as failed:
            _log.error("left to be finished later: %s", failed)
        self._statistics.state("starting", f"not recording: {reason}")

    def _try_again(self) -> None:
        try:
            place = _place(self._context)
            if shutil.disk_usage(place.parent).free >= SPACE_KEPT:
                self._notes.recover_unfinished()
                self._open()
                self._statistics.state("ready")
        except OSError:
            pass  # told when it began


class _Notes:
    """A file in the instance's folder that names the bags not finished yet."""

    def __init__(self, file: Path) -> None:
        self._file = file

    def recover_unfinished(self) -> None:
        """Finish what an earlier run of this instance left."""
        for path in self._unfinished():
            try:
                found = recover(path)
                _log.info("%s: recovered, %d messages", path, found.messages)
            except BagError as error:
                _log.warning("not recovered: %s", error)
        self._file.unlink(missing_ok=True)

    def begun(self, path: Path) -> None:
        self._write([*self._unfinished(), path])

    def finished(self, path: Path) -> None:
        self._write([each for each in self._unfinished() if each != path])

    def _unfinished(self) -> list[Path]:
        try:
            return [Path(name) for name in json.loads(self._file.read_text())["unfinished"]]
        except (OSError, ValueError, KeyError, TypeError):
            return []

    def _write(self, paths: list[Path]) -> None:
        if not paths:
            self._file.unlink(missing_ok=True)
            return
        beside = self._file.with_suffix(".new")
        beside.write_text(json.dumps({"unfinished": [str(path) for path in paths]}))
        os.replace(beside, self._file)


def _place(context: Context) -> Path:
    """Where the settings want the bag; a folder gets a file named by date and time."""
    wanted = context.settings.bag
    if wanted is None or wanted.is_dir():
        folder = wanted or context.instance.bags
        return folder / f"{datetime.now():%Y-%m-%d_%H-%M-%S}{SUFFIX}"
    if wanted.suffix != SUFFIX:
        raise ConfigurationError(f"bag: {wanted}: expected a folder or a name that ends in {SUFFIX}")
    return wanted


def _unused(path: Path) -> Path:
    """The path, or with a number where a file stands already: no bag is ever overwritten."""
    candidate, number = path, 0
    while candidate.exists():
        number += 1
        candidate = path.with_stem(f"{path.stem}_{number}")
    return candidate


def _told(error: OSError, path: Path) -> str:
    return f"{error.filename or path}: {error.strerror or error}"
