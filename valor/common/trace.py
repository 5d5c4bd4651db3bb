"""What a service's loop does when, stage by stage: for ``valorctl trace``, and only while somebody listens.

A loop marks the end of each stage; a stage lasts from the mark before to its own, so that a service's time is divided
up without a rest. All stamps are of the monotonic clock, which the processes of a computer share.

Whoever subscribes to ``<service>/trace`` switches a service's marks on, whoever leaves switches them off; until then
there is no publisher, and a mark is one call of a function that does nothing. Used from the loop's own thread.
"""

from __future__ import annotations

import gc
import os
import threading
import time
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path

import numpy as np

import bifrost
from bifrost import Float64Array, Message, Uint8Array

FLUSH_PERIOD = 0.25  # between two messages [s]
_TRIALS = 50  # marks and readings from which their own cost is told
_NETWORK_THREAD = "ZMQbg/IO/0"  # encrypts and sends what the process sends, and the other way round


class Stage(IntEnum):
    """What a loop was at until a mark."""

    PUBLISH = 0  # comms_manager: sends Proprioceptor
    AWAIT_MOTOR = 1  # takes Motor in, waits for it
    PHYSICS = 2
    DEVICES = 3  # on hardware
    MEASURE = 4
    ATTEND = 5  # what is due beside the period: truth, requests, clock, statistics, reports
    SLEEP = 6  # until the end of the period is due
    OVERSLEEP = 7  # from then until it woke
    AWAIT = 8  # motion_manager, valor_ros_controller: for something to come
    DECODE = 9
    TAKE_COMMANDS = 10
    CONTROL = 11  # estimator, state machines, whole-body control
    SEND_MOTOR = 12
    SEND_STATE = 13
    PUBLISH_JOINTS = 14  # valor_ros_controller
    CONTROLLERS = 15
    PUBLISH_ROS = 16
    REST = 17  # bag_recorder: until the next look
    DISCOVER = 18
    DRAIN_BIFROST = 19
    DRAIN_ROS = 20
    WRITE = 21  # hands the chunk to the system
    # No stages, but what happened within them.
    COLLECT = 22  # Python's garbage collector; ``cpu`` is when it began
    CORE = 23  # how long threads have waited for a core: the loop's in ``cpu``, the network's in ``value`` [s]


IDLE = frozenset({Stage.AWAIT_MOTOR, Stage.SLEEP, Stage.OVERSLEEP, Stage.AWAIT, Stage.REST})


class Trace(Message):
    """Marks of one service, n of them in the order of time."""

    service: str
    stages: Uint8Array  # (n,) ``Stage``
    at: Float64Array  # (n,) monotonic [s]
    cpu: Float64Array  # (n,) that the loop's thread had used by then [s]
    value: Float64Array  # (n,) sequence of the Proprioceptor that it concerns; 0: none
    mark_cost: float  # of one mark [s]
    cycle_cost: float  # of the end of a cycle, without sending this [s]
    flush_cost: float  # of making and sending the message before this [s]


def topic(service: str) -> str:
    """Where a service's marks are published."""
    return f"{service}/trace"


class Tracer:
    """One service's marks."""

    def __init__(self, node: bifrost.Node, service: str) -> None:
        self._node = node
        self._service = service
        self._publisher: bifrost.Publisher[Trace] | None = None
        self._rows: list[tuple[int, float, float, float]] = []
        self._flush_at = 0.0
        self._costs = (0.0, 0.0)
        self._flush_cost = 0.0
        self._collecting = 0.0
        self._files: tuple[int, ...] = ()
        self._changed = False
        self.mark = self._ignore
        self._watch = node.discovery.watch("subscriber", topic(service), self._listeners_changed)
        self._listeners_changed()

    def cycle(self) -> None:
        """The end of a turn of the loop, where it has time: to begin or end, and to send what was marked."""
        if self._changed:
            self._changed = False
            self._switch(on=bool(self._watch.peers))
        if self._publisher is not None:
            self._read_cores()
            if (now := time.monotonic()) >= self._flush_at:
                self._flush(now)

    def _listeners_changed(self) -> None:
        """Called in the discovery thread."""
        self._changed = True

    def _ignore(self, stage: Stage, sequence: int = 0, at: float = 0.0) -> None:
        """End a stage: now, or at a moment that has passed [monotonic, s]."""

    def _note(self, stage: Stage, sequence: int = 0, at: float = 0.0) -> None:
        self._rows.append((stage, at or time.monotonic(), time.thread_time(), sequence))

    def _switch(self, on: bool) -> None:
        if on == (self._publisher is not None):
            return
        if on:
            self._publisher = self._node.publisher(topic(self._service), Trace)
            self._files = tuple(os.open(task / "schedstat", os.O_RDONLY) for task in _own_tasks())
            self._costs = self._cost_of(lambda: self._note(Stage.CORE)), self._cost_of(self._read_cores)
            self._rows.clear()
            self._flush_at = time.monotonic() + FLUSH_PERIOD
            self.mark = self._note
            gc.callbacks.append(self._collects)
            return
        self.mark = self._ignore
        gc.callbacks.remove(self._collects)
        for file in self._files:
            os.close(file)
        self._rows.clear()
        assert self._publisher is not None
        self._publisher.close()
        self._publisher = None

    @staticmethod
    def _cost_of(call: Callable[[], None]) -> float:
        began = time.monotonic()
        for _ in range(_TRIALS):
            call()
        return (time.monotonic() - began) / _TRIALS

    def _read_cores(self) -> None:
        """How long the loop's and the network's thread have been ready to run without a core, so far."""
        waited = [int(os.pread(file, 64, 0).split()[1]) * 1e-9 for file in self._files]
        self._rows.append((Stage.CORE, time.monotonic(), waited[0], waited[-1]))

    def _collects(self, phase: str, _info: dict[str, int]) -> None:
        """Python's garbage collector begins or has ended; in whatever thread."""
        if phase == "start":
            self._collecting = time.monotonic()
        else:
            self._rows.append((Stage.COLLECT, time.monotonic(), self._collecting, 0.0))

    def _flush(self, now: float) -> None:
        assert self._publisher is not None
        self._flush_at = now + FLUSH_PERIOD
        columns = np.array(self._rows).T
        self._rows.clear()
        at, cpu, value = columns[1:].copy()
        mark_cost, cycle_cost = self._costs
        self._publisher.publish(
            Trace(
                service=self._service,
                stages=columns[0].astype(np.uint8),
                at=at,
                cpu=cpu,
                value=value,
                mark_cost=mark_cost,
                cycle_cost=cycle_cost,
                flush_cost=self._flush_cost,
            )
        )
        self._flush_cost = time.monotonic() - now


def _own_tasks() -> list[Path]:
    """Of the calling thread and of the network's, if there is one."""
    own = Path(f"/proc/self/task/{threading.get_native_id()}")
    network = [task for task in own.parent.iterdir() if (task / "comm").read_text().strip() == _NETWORK_THREAD]
    return [own, *network]
