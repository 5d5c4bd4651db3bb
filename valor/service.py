"""What every service does alike: start, say that it is ready, count its cycles, stop when told.

A service's ``__main__.py`` is ``run("name", Class)``; its ``service.py`` holds the loop.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import logging
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import FrameType
from typing import Any, Protocol, Self

import bifrost
from valor.common import membership
from valor.common.errors import ConfigurationError
from valor.common.floods import Floods, Input, TopicFloods
from valor.common.freshness import Freshness
from valor.common.instance import Instance, Settings
from valor.common.messages import Statistics
from valor.common.priority import take_cores, take_priority, take_turns
from valor.common.processes import BY_NAME, EXIT_CONFIGURATION, Process
from valor.common.topics import STATISTICS, Topic
from valor.common.trace import Tracer
from valor.robot.description import RobotDescription

_LOG_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"


class Context:
    """What a service is given: instance, robot, Bifrost node, statistics, trace, and the word to stop.

    Attributes:
        arguments: of the command line: ROS', where the process has a node there.
        stopping: set by SIGTERM and SIGINT; the loop returns soon after.
    """

    def __init__(self, name: str, instance: Instance, arguments: Sequence[str] = ()) -> None:
        self.name = name
        self.arguments = tuple(arguments)
        self.instance = instance
        self.settings: Settings = instance.settings()
        process = BY_NAME[name]
        if self.settings.variant == "hardware":
            take_priority(process.priority)
        elif self.settings.paced:
            self._take_cores(process)
        if self.settings.paced:
            take_turns(process.turns)
        self.robot = RobotDescription.load(self.settings.robot, self.settings.control_rate)
        self.stopping = threading.Event()
        self.node = bifrost.Node(name, network=membership.network(instance, name))
        self.statistics = StatisticsPublisher(self.node, name, self.robot.control_period)
        self.trace = Tracer(self.node, name)

    @staticmethod
    def _take_cores(process: Process) -> None:
        """Before any thread is started, for threads stay where they are started."""
        core = take_cores(process.cores)
        if process.cores == "own":
            what = "no core of its own: there is one only, or it is not granted" if core is None else f"on core {core}"
            logging.getLogger(process.name).info("%s", what)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.statistics.state("stopping")
        self.node.close()


class Service(Protocol):
    """A service: made from its context, then run until ``context.stopping`` is set."""

    def run(self) -> None:
        """Return when ``context.stopping`` is set."""

    def close(self) -> None:
        """Give back everything; called once, after ``run`` and after a failed start."""


class StatisticsPublisher:
    """Counts a loop's cycles and publishes ``<service>/statistics`` once a second and at every change of state.

    Latched: whoever begins to listen is told the newest at once. Used from the loop's own thread.
    """

    PERIOD = 1.0  # [s]

    def __init__(self, node: bifrost.Node, service: str, control_period: float) -> None:
        self._publisher = STATISTICS[service].publisher(node)
        self._service = service
        self._control_period = control_period
        self._cpu_time = time.process_time()
        self._state, self._detail = "starting", ""
        self._cycles = self._overruns = 0
        self.drops = self.rejected = 0
        self._count: Callable[[], tuple[int, int]] | None = None
        self._floods: tuple[Floods | TopicFloods, ...] = ()
        self._freshness: Freshness | None = None
        self._last_cycle = 0.0
        self._reset(time.perf_counter())

    def _reset(self, now: float) -> None:
        self._window_start = now
        self._window_cycles = 0
        self._work_sum = self._work_max = self._period_sum = self._period_max = 0.0

    def state(self, state: str, detail: str = "") -> None:
        """Say that the service is ``starting`` (and what it waits for), ``ready``, ``degraded`` or ``stopping``.

        Degraded: it runs, others may count on that, but what it is there for it cannot do now; ``detail`` says why.
        """
        if (state, detail) != (self._state, self._detail):
            self._state, self._detail = state, detail
            self._publish(time.perf_counter())

    @property
    def ready(self) -> bool:
        """Whether the service has said that it is ready."""
        return self._state == "ready"

    def count(self, counts: Callable[[], tuple[int, int]]) -> None:
        """Ask for ``rejected`` and ``drops`` when they are told, so that a loop need not sum them up every cycle."""
        self._count = counts

    def watch(self, inputs: Iterable[Input], ros: TopicFloods | None = None) -> None:
        """Be ``degraded`` in place of ``ready`` while a sender floods one of these, and name it."""
        self._floods = (Floods(inputs), *((ros,) if ros else ()))

    def depend(self, inputs: Mapping[Topic[Any], bifrost.Subscriber[Any]], robot_time: Callable[[], int]) -> None:
        """While ``ready`` with nothing else to say, name those of these topics that do not come as they should.

        Args:
            inputs: a subscriber of each topic that the service lives by.
            robot_time: the newest that the service knows [ns].
        """
        self._freshness = Freshness(inputs, 1.0 / self._control_period, robot_time)

    def cycle(self, began: float, waited: float = 0.0) -> None:
        """Count a cycle that began at ``began`` [``time.perf_counter()``, s; Linux: the monotonic clock] and ends now.

        ``waited`` [s] of it were spent waiting, not working.
        """
        now = time.perf_counter()
        work = now - began - waited
        self._cycles += 1
        self._window_cycles += 1
        self._work_sum += work
        self._work_max = max(self._work_max, work)
        if self._last_cycle:
            period = began - self._last_cycle
            self._period_sum += period
            self._period_max = max(self._period_max, period)
        self._last_cycle = began
        self._overruns += work > self._control_period
        if now - self._window_start >= self.PERIOD:
            self._publish(now)

    def idle(self) -> None:
        """Publish if a second has passed; for loops that have nothing to count."""
        now = time.perf_counter()
        if now - self._window_start >= self.PERIOD:
            self._publish(now)

    def _publish(self, now: float) -> None:
        if self._count is not None:
            self.rejected, self.drops = self._count()
        state, detail = self._state, self._detail
        if state == "ready" and (flood := "; ".join(filter(None, (each.told() for each in self._floods)))):
            state, detail = "degraded", flood
        elif state == "ready" and not detail and self._freshness is not None:
            detail = self._freshness.told()
        cycles = max(1, self._window_cycles)
        cpu_time = time.process_time()
        newest = Statistics(
            service=self._service,
            pid=os.getpid(),
            state=state,
            detail=detail,
            cycles=self._cycles,
            cycle_time_mean=self._work_sum / cycles,
            cycle_time_max=self._work_max,
            period_mean=self._period_sum / cycles,
            period_max=self._period_max,
            overruns=self._overruns,
            cpu_percent=100.0 * (cpu_time - self._cpu_time) / max(now - self._window_start, 1e-6),
            memory_mib=_resident() / 2**20,
            drops=self.drops,
            rejected=self.rejected,
        )
        self._publisher.publish(newest)
        self._cpu_time = cpu_time
        self._reset(now)


def _resident() -> int:
    """Memory of this process that is in RAM [B]. Without psutil, whose import alone takes 2 MiB of every service."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


def quiet_collector() -> None:
    """Take the garbage collector out of a control loop: what lives now lives on, cycles are collected rarely.

    What starting has left free goes back to the kernel: several MiB in a process with rclpy.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 50, 50)
    with contextlib.suppress(OSError, AttributeError):  # another C library than glibc
        ctypes.CDLL(None).malloc_trim(0)


def run(name: str, make: Callable[[Context], Service]) -> int:
    """Start a service and run it until SIGTERM or SIGINT. Returns the exit status."""
    logging.basicConfig(level=logging.INFO, format=_LOG_FORMAT, stream=sys.stderr)
    log = logging.getLogger(name)
    if {"-h", "--help"} & set(sys.argv[1:]):
        print(f"python -m valor.{name}: {BY_NAME[name].description}; in the instance that VALOR_INSTANCE names.")
        return 0
    try:
        context = Context(name, Instance.from_environment(), sys.argv[1:])
    except (ConfigurationError, bifrost.ConfigurationError) as error:
        log.error("%s", error)
        return EXIT_CONFIGURATION

    def stop(signum: int, _frame: FrameType | None) -> None:
        context.stopping.set()

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    with context:
        try:
            service = make(context)
        except ConfigurationError as error:
            log.error("%s", error)
            return EXIT_CONFIGURATION
        try:
            service.run()
        finally:
            service.close()
    log.info("stopped")
    return 0
