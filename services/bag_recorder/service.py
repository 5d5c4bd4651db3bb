"""The recorder's loop: ten times a second hand on what has come from both sides."""

from __future__ import annotations

import logging
import math
import time

from valor.bag_recorder.bifrost_tap import BifrostTap
from valor.bag_recorder.clock import WallClock
from valor.bag_recorder.continuous import Continuous
from valor.bag_recorder.last_seconds import LastSeconds, refused
from valor.bag_recorder.parameters import settings_of
from valor.bag_recorder.ros_tap import RosTap
from valor.bag_recorder.shelf import Shelf, told, wall_time
from valor.bags import recordings
from valor.bags.selection import Selection
from valor.common.errors import ConfigurationError
from valor.common.messages import MarkReply, MarkRequest, SnapReply, SnapRequest
from valor.common.resources import REPAIR
from valor.common.topics import MARK, MOTION_STATE, SNAP
from valor.common.trace import Stage
from valor.ros.definitions import UnknownTypeError
from valor.ros.node import RosSide
from valor.service import Context, quiet_collector

PERIOD = 0.1  # between two looks [s]; a look at some ninety topics has its price, and queues hold seconds
DISCOVERY_PERIOD = 0.25  # [s]
CLOCK_PERIOD = 1.0  # [s]
LONGEST_MARK = 200  # characters
GRACE = 0.05  # for what was sent before the recorder was told to stop, and is on its way [s]

_log = logging.getLogger("bag_recorder")


class BagRecorder:
    """The service. One thread does everything but receiving, which ZeroMQ and Fast DDS do in threads of their own.

    Raises:
        ConfigurationError: no bag can be written where the settings say.
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
        self._side.life.configured()

    def _assemble(self, context: Context) -> None:
        context.settings = settings_of(self._side.node, context.settings)
        settings = context.settings.recording
        selection = Selection(settings.only, settings.without)
        self._clock = WallClock()
        self._shelf = Shelf(context, self._clock, self._counts)
        context.statistics.state("starting", "subscribing")
        try:
            self._bifrost = BifrostTap(context.node, self._clock, selection=selection, alive=self._statistics.idle)
        except UnknownTypeError as error:
            raise ConfigurationError(f"{error}: {REPAIR}") from None
        self._statistics.depend(self._bifrost.heard, lambda: self._bifrost.time)
        self._ros = RosTap(self._side.node, self._clock, selection, self._statistics.idle, context.settings.namespace)
        self._snaps = SNAP.server(context.node, self._snap)
        self._marks = MARK.server(context.node, self._mark)
        self._recording: Continuous | LastSeconds
        if settings.ring_seconds is not None:
            self._recording = LastSeconds(self._shelf, settings.ring_seconds)
            self._states = MOTION_STATE.subscriber(context.node)
            _log.info("holding the last %g s", settings.ring_seconds)
            return
        try:
            self._recording = Continuous(self._shelf, self._clock, *_piece(context))
        except OSError as error:
            raise ConfigurationError(told(error, self._shelf.place())) from None

    def run(self) -> None:
        """Record until told to stop."""
        self._ros.discover()
        quiet_collector()
        self._tell_state()
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
                self._recording.attend()
                trace.mark(Stage.WRITE)
            except OSError as error:
                self._recording.failed(error)
            self._tell_state()
            self._snaps.serve()
            self._marks.serve()
            self._side.attend()
            self._statistics.idle()
            trace.cycle()
            trace.mark(Stage.ATTEND)

    def close(self) -> None:
        """Take what still waits, finish the bag, tell what became of each topic, and leave both sides."""
        try:
            time.sleep(GRACE)
            self._drain()
            self._recording.close()
        except OSError as error:
            self._recording.failed(error)
        self._shelf.tell()
        self._shelf.close()
        self._side.close()

    def _counts(self) -> dict[str, tuple[int, int]]:
        """Received and dropped since start, by topic."""
        return self._bifrost.counts | self._ros.counts

    def _drain(self) -> None:
        sink = None if self._side.life.paused else self._recording.sink
        self._bifrost.drain(sink)
        self._context.trace.mark(Stage.DRAIN_BIFROST)
        self._ros.drain(sink)
        self._context.trace.mark(Stage.DRAIN_ROS)
        state = self._states.latest() if isinstance(self._recording, LastSeconds) else self._bifrost.state
        if state is not None:
            self._recording.heard(state.message, state.stamp + self._clock.offset)

    def _check_clock(self) -> None:
        change = self._clock.check()
        if change is not None:
            _log.warning("%s", change.describe())
            self._recording.note(change)

    def _tell_state(self) -> None:
        failure = self._recording.failure or ("paused (lifecycle state inactive)" if self._side.life.paused else "")
        if failure:
            self._statistics.state("degraded", f"not recording: {failure}")
        else:
            self._statistics.state("ready")
        self._side.life.tell(True)

    def _snap(self, request: SnapRequest, origin: str) -> SnapReply:
        if not isinstance(self._recording, LastSeconds):
            return refused(
                "everything is being recorded; expected a recorder that holds the last seconds (up --bag-ring)"
            )
        _log.info("asked by %s to save the last seconds", origin)
        self._drain()
        return self._recording.snap("snap")

    def _mark(self, request: MarkRequest, origin: str) -> MarkReply:
        text, stamp = " ".join(request.text.split()), wall_time(self._clock)
        if not 1 <= len(text) <= LONGEST_MARK:
            return MarkReply(False, stamp, f"text: {len(text)} characters; expected 1 to {LONGEST_MARK}")
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
    """Size [B] and age [s] at which the next bag begins: as told, and among those that are bounded what fits in."""
    settings, bags = context.settings.recording, context.instance.bags
    size, age = float(settings.split_bytes), settings.split_seconds or math.inf
    if context.settings.bag is None:
        largest, longest = settings.bounds.piece(recordings.disk_of(bags).capacity)
        size, age = min(size, largest), min(age, longest)
    return size, age
