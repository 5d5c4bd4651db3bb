"""Bag Recorder: moves messages from Bifrost and ROS subscriptions into bags, ten times a second."""

import logging
import math
import time
from pathlib import Path

import msgspec
from rclpy.node import Node

from valor.bag_recorder.bag_store import FALL, BagStore, one_line, wall_time
from valor.bag_recorder.bifrost_tap import BifrostTap
from valor.bag_recorder.clock import StampConverter
from valor.bag_recorder.recording import Continuous, LastSeconds, rejected
from valor.bag_recorder.ros_tap import RosTap
from valor.bags import retention
from valor.bags.selection import Selection
from valor.common.errors import ConfigurationError
from valor.common.instance import Recording, Settings
from valor.common.messages import MarkReply, MarkRequest, SnapReply, SnapRequest
from valor.common.resources import REPAIR
from valor.common.table import checked, plain
from valor.common.topics import MARK, MOTION_STATE, SNAP
from valor.common.trace import Stage
from valor.ros.definitions import UnknownTypeError
from valor.ros.node import RosSide
from valor.ros.parameters import Parameters, Range
from valor.service import Context, quiet_collector

_MOST_BYTES, _MOST_SECONDS = 2**62, 1e9
PERIOD = 0.1  # of the loop [s]; queues hold seconds, and each cycle polls about ninety topics
DISCOVERY_PERIOD = 0.25  # [s]
CLOCK_PERIOD = 1.0  # [s]
MARK_LIMIT = 200  # characters
GRACE = 0.05  # at the end, for messages in transit [s]
_log = logging.getLogger("bag_recorder")


def settings_of(node: Node, settings: Settings) -> Settings:
    """The settings with the node's parameters; raises ``ConfigurationError`` with an invalid one."""
    declare, recording = Parameters(node).declare, settings.recording
    default = "folder or .mcap file to write to; '': a new one in the instance's bags"
    uri = declare("storage.uri", str(settings.bag or ""), default)
    only = declare("record.topics", [*recording.only] or [""], "shell patterns of topics in the bag; '': all")
    excluded = "shell patterns of topics left out of it; '': none"
    without = declare("record.exclude_topics", [*recording.without] or [""], excluded)
    split, sizes = "the next bag begins after so much [B]", Range(1 << 20, _MOST_BYTES)
    size = declare("storage.max_bagfile_size", recording.split_bytes, split, sizes)
    split, ages = "the next bag begins after so long [s], from 1; 0: never for that", Range(0.0, _MOST_SECONDS)
    age = declare("storage.max_bagfile_duration", recording.split_seconds or 0.0, split, ages)
    held = "hold the last seconds, from 1, and write them when asked or on a fall [s]; 0: write everything"
    ring = declare("ring_seconds", recording.ring_seconds or 0.0, held, Range(0.0, 600.0))
    for name, value in (("storage.max_bagfile_duration", age), ("ring_seconds", ring)):
        if 0.0 < value < 1.0:
            raise ConfigurationError(f"ROS parameter {name}: {value:g} s; expected 0, or 1 and more")
    changes = {
        "only": [pattern for pattern in only if pattern],
        "without": [pattern for pattern in without if pattern],
        "split_bytes": size,
        "split_seconds": age or None,
        "ring_seconds": ring or None,
    }
    changed = checked(Recording, plain(recording) | changes)
    return msgspec.structs.replace(settings, bag=Path(uri).absolute() if uri else None, recording=changed)


class BagRecorder:
    """The service. One thread does everything except receiving, for which ZeroMQ and Fast DDS have threads.

    Raises ConfigurationError: no bag can be written at the configured path.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._statistics = context.statistics
        self._side = RosSide(
            context.name, context.settings, context.instance.environment(), context.arguments,
            sim_time=False, pause=lambda: "",
        )  # fmt: skip
        try:
            self._assemble(context)
        except BaseException:
            self._side.close()
            raise
        self._side.life.configure()

    def _assemble(self, context: Context) -> None:
        context.settings = settings_of(self._side.node, context.settings)
        settings = context.settings.recording
        selection = Selection(settings.only, settings.without)
        self._clock = StampConverter()
        self._store = BagStore(context, self._clock, self._counts)
        self._fallen = False
        context.statistics.state("starting", "subscribing")
        try:
            self._bifrost = BifrostTap(context.node, self._clock, selection=selection, alive=self._statistics.idle)
        except UnknownTypeError as error:
            raise ConfigurationError(f"{error}: {REPAIR}") from None
        self._statistics.depend(self._bifrost.subscribers, lambda: self._bifrost.time)
        self._ros = RosTap(self._side.node, self._clock, selection, self._statistics.idle, context.settings.namespace)
        self._snaps = SNAP.server(context.node, self._snap)
        self._marks = MARK.server(context.node, self._mark)
        self._recording: Continuous | LastSeconds
        if settings.ring_seconds is not None:
            self._recording = LastSeconds(self._store, settings.ring_seconds)
            self._states = MOTION_STATE.subscriber(context.node)
            _log.info("holding the last %g s", settings.ring_seconds)
            return
        try:
            self._recording = Continuous(self._store, self._clock, *_piece(context))
        except OSError as error:
            raise ConfigurationError(one_line(error, self._store.path())) from None

    def run(self) -> None:
        self._ros.discover()
        quiet_collector()
        self._report_state()
        now = time.monotonic()
        next_discovery, next_clock = now + DISCOVERY_PERIOD, now + CLOCK_PERIOD
        trace = self._context.trace
        while not self._context.stopping.wait(PERIOD):
            now = time.monotonic()
            trace.mark(Stage.REST)
            if now >= next_discovery:
                next_discovery = now + DISCOVERY_PERIOD
                self._ros.discover()
                self._statistics.drops = sum(dropped for _, dropped in self._counts().values())
            trace.mark(Stage.DISCOVER)
            try:
                if now >= next_clock or self._clock.moved():
                    next_clock = now + CLOCK_PERIOD
                    self._check_clock()
                self._drain()
                self._recording.update()
                trace.mark(Stage.WRITE)
            except OSError as error:
                self._recording.failed(error)
            self._report_state()
            self._snaps.serve()
            self._marks.serve()
            self._side.serve_pending()
            self._statistics.idle()
            trace.cycle()
            trace.mark(Stage.ATTEND)

    def close(self) -> None:
        """Write the remaining messages, finish the bag, and leave Bifrost and ROS."""
        try:
            time.sleep(GRACE)
            self._drain()
            self._recording.close()
        except OSError as error:
            self._recording.failed(error)
        self._store.close()
        self._side.close()

    def _counts(self) -> dict[str, tuple[int, int]]:
        return self._bifrost.counts | self._ros.counts

    def _drain(self) -> None:
        sink = None if self._side.life.paused else self._recording.sink
        self._bifrost.drain(sink)
        self._context.trace.mark(Stage.DRAIN_BIFROST)
        self._ros.drain(sink)
        self._context.trace.mark(Stage.DRAIN_ROS)
        state = self._states.latest() if isinstance(self._recording, LastSeconds) else self._bifrost.state
        if state is not None:
            fallen = state.message.behavior == FALL
            if fallen and not self._fallen:
                self._recording.fall(state.stamp + self._clock.offset, state.message.reason)
            self._fallen = fallen

    def _check_clock(self) -> None:
        change = self._clock.check()
        if change is not None:
            _log.warning("%s", change.describe())
            self._recording.clock_changed(change)

    def _report_state(self) -> None:
        failure = self._recording.failure or ("paused (lifecycle state inactive)" if self._side.life.paused else "")
        if failure:
            self._statistics.state("degraded", f"not recording: {failure}")
        else:
            self._statistics.state("ready")
        self._side.life.set_ready(True)

    def _snap(self, request: SnapRequest, origin: str) -> SnapReply:
        if not isinstance(self._recording, LastSeconds):
            return rejected(
                "everything is being recorded; expected a recorder that holds the last seconds (`up --bag-ring`)"
            )
        _log.info("%s requested the last seconds", origin)
        self._drain()
        return self._recording.snap("snap")

    def _mark(self, request: MarkRequest, origin: str) -> MarkReply:
        text, stamp = " ".join(request.text.split()), wall_time(self._clock)
        if not 1 <= len(text) <= MARK_LIMIT:
            return MarkReply(False, stamp, f"text: {len(text)} characters; expected 1 to {MARK_LIMIT}")
        if self._side.life.paused:
            return MarkReply(False, stamp, "not recording: paused (lifecycle state inactive)")
        try:
            reason = self._recording.mark(text, stamp)
        except OSError as error:
            self._recording.failed(error)
            reason = f"not recording: {self._recording.failure}"
        if not reason:
            _log.info("marked by %s: %s", origin, text)
        return MarkReply(not reason, stamp, reason)


def _piece(context: Context) -> tuple[float, float]:
    """Size [B] and age [s] at which the next bag starts: as configured, and small enough for the bounds."""
    settings, bags = context.settings.recording, context.instance.bags
    size, age = float(settings.split_bytes), settings.split_seconds or math.inf
    if context.settings.bag is None:
        largest, longest = settings.bounds.piece(retention.disk_of(bags).capacity)
        size, age = min(size, largest), min(age, longest)
    return size, age
