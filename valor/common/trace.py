"""Timing marks of a service's loop, stage by stage, while ``valorctl trace`` subscribes to ``<service>/trace``.

A stage lasts from the previous mark to its own. Stamps are of the monotonic clock, which the processes of a computer
share. Without a subscriber a mark is one call of a function without effect. Marks belong to the loop's own thread.
"""

import gc
import time
from enum import IntEnum

import numpy as np

import bifrost
from bifrost import Float64Array, Message, Uint8Array

FLUSH_PERIOD = 0.25  # between two messages [s]


class Stage(IntEnum):
    """What a loop did until a mark."""

    PUBLISH = 0  # comms_manager: sends Proprioceptor
    AWAIT_MOTOR = 1  # receives Motor, waits for it
    PHYSICS = 2
    DEVICES = 3  # on hardware
    MEASURE = 4
    ATTEND = 5  # work outside the control period: truth, requests, clock, statistics, reports
    SLEEP = 6  # until the end of the period is due
    OVERSLEEP = 7  # from then until it woke
    AWAIT = 8  # motion_manager, valor_ros_controller: for messages
    DECODE = 9
    TAKE_COMMANDS = 10
    CONTROL = 11  # estimator, state machines, whole-body control
    SEND_MOTOR = 12
    SEND_STATE = 13
    PUBLISH_JOINTS = 14  # valor_ros_controller
    CONTROLLERS = 15
    PUBLISH_ROS = 16
    REST = 17  # bag_recorder: until the next poll
    DISCOVER = 18
    DRAIN_BIFROST = 19
    DRAIN_ROS = 20
    WRITE = 21  # passes the chunk to the operating system
    COLLECT = 22  # no stage, but an event within one: Python's garbage collector; ``cpu`` is its start [monotonic, s]


class Trace(Message):
    """Marks of one service, n of them, in order of time."""

    service: str
    stages: Uint8Array  # (n,) ``Stage``
    at: Float64Array  # (n,) end of the stage, monotonic [s]
    cpu: Float64Array  # (n,) processor time of the loop's thread by then [s]
    sequence: Float64Array  # (n,) of the Proprioceptor that the stage concerns; 0: none


def topic(service: str) -> str:
    """Topic of a service's marks."""
    return f"{service}/trace"


class Tracer:
    """Marks of one service."""

    def __init__(self, node: bifrost.Node, service: str) -> None:
        self._node = node
        self._service = service
        self._publisher: bifrost.Publisher[Trace] | None = None
        self._rows: list[tuple[int, float, float, float]] = []
        self._flush_at = 0.0
        self._collecting = 0.0
        self._changed = False
        self.mark = self._ignore
        self._watch = node.discovery.watch("subscriber", topic(service), self._subscribers_changed)
        self._subscribers_changed()

    def cycle(self) -> None:
        """End a cycle of the loop: switch the marks on or off, and publish them."""
        if self._changed:
            self._changed = False
            self._switch(on=bool(self._watch.peers))
        if self._publisher is not None and time.monotonic() >= self._flush_at and self._rows:
            self._flush(self._publisher)

    def _subscribers_changed(self) -> None:
        """Called in the discovery thread."""
        self._changed = True

    def _ignore(self, stage: Stage, sequence: int = 0, at: float = 0.0) -> None:
        """End a stage: now, or at an earlier moment [monotonic, s]."""

    def _note(self, stage: Stage, sequence: int = 0, at: float = 0.0) -> None:
        self._rows.append((stage, at or time.monotonic(), time.thread_time(), sequence))

    def _switch(self, on: bool) -> None:
        if on == (self._publisher is not None):
            return
        self._rows.clear()
        if on:
            self._publisher = self._node.publisher(topic(self._service), Trace)
            self._flush_at = time.monotonic() + FLUSH_PERIOD
            self.mark = self._note
            gc.callbacks.append(self._collects)
            return
        self.mark = self._ignore
        gc.callbacks.remove(self._collects)
        assert self._publisher is not None
        self._publisher.close()
        self._publisher = None

    def _collects(self, phase: str, _info: dict[str, int]) -> None:
        if phase == "start":
            self._collecting = time.monotonic()
        else:
            self._rows.append((Stage.COLLECT, time.monotonic(), self._collecting, 0.0))

    def _flush(self, publisher: bifrost.Publisher[Trace]) -> None:
        self._flush_at = time.monotonic() + FLUSH_PERIOD
        stages, at, cpu, sequence = np.array(self._rows).T.copy()
        self._rows.clear()
        publisher.publish(Trace(self._service, stages.astype(np.uint8), at, cpu, sequence))
