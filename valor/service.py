"""Common part of all services: startup, state, statistics of the loop, end.

A service's ``__main__.py`` is ``run("name", Class)``; its ``service.py`` holds the loop.
"""

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
from valor.common import topics
from valor.common.errors import ConfigurationError
from valor.common.input_checks import Floods, Freshness, Input, TopicFloods
from valor.common.instance import Instance, Settings
from valor.common.messages import Statistics
from valor.common.priority import take_cores, take_priority, take_turns
from valor.common.processes import BY_NAME, EXIT_CONFIGURATION
from valor.common.topics import STATISTICS, Topic
from valor.common.trace import Tracer
from valor.robot.description import RobotDescription

_LOG_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"


class Context:
    """Environment of a service: instance, robot, Bifrost node, statistics, trace.

    SIGTERM and SIGINT set ``stopping``; the loop then returns. ``arguments``: of the command line, for ROS.
    """

    def __init__(self, name: str, instance: Instance, arguments: Sequence[str] = ()) -> None:
        self.name = name
        self.arguments = tuple(arguments)
        self.instance = instance
        self.settings: Settings = instance.settings()
        process = BY_NAME[name]
        if self.settings.variant == "hardware":
            take_priority(process.priority)
        elif self.settings.paced:  # before any thread starts: threads inherit the cores
            core = take_cores(process.cores)
            if process.cores == "own":
                text = "no separate core: the computer has one, or does not grant it"
                logging.getLogger(name).info(text if core is None else f"on core {core}")
        if self.settings.paced:
            take_turns(process.turns)
        self.robot = RobotDescription.load(self.settings.robot, self.settings.control_rate)
        self.stopping = threading.Event()
        self.node = bifrost.Node(name, network=topics.network(instance, name))
        self.statistics = StatisticsPublisher(self.node, name, self.robot.control_period)
        self.trace = Tracer(self.node, name)

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
        """Release all resources; called once, after ``run`` and after a failed start."""


class StatisticsPublisher:
    """Counts a loop's cycles and publishes ``<service>/statistics`` once a second and at every change of state.

    The topic is latched. Use from the loop's thread only.
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
        """Publish the state ``starting`` (detail: what it waits for), ``ready``, ``degraded`` or ``stopping``.

        Degraded: the service runs, but cannot perform its task; ``detail`` gives the reason.
        """
        if (state, detail) != (self._state, self._detail):
            self._state, self._detail = state, detail
            self._publish(time.perf_counter())

    @property
    def ready(self) -> bool:
        """True if the service has reported that it is ready."""
        return self._state == "ready"

    def count(self, counts: Callable[[], tuple[int, int]]) -> None:
        """Set the source of ``rejected`` and ``drops``, called at each publication and not in each cycle."""
        self._count = counts

    def watch(self, inputs: Iterable[Input], ros: TopicFloods | None = None) -> None:
        """Report ``degraded`` instead of ``ready`` while a sender floods one of the inputs, with its name."""
        self._floods = (Floods(inputs), *((ros,) if ros else ()))

    def depend(self, inputs: Mapping[Topic[Any], bifrost.Subscriber[Any]], robot_time: Callable[[], int]) -> None:
        """Name late or invalid ``inputs`` in the detail of ``ready``; ``robot_time``: latest received [ns]."""
        self._freshness = Freshness(inputs, 1.0 / self._control_period, robot_time)

    def cycle(self, began: float, waited: float = 0.0) -> None:
        """Count a cycle from ``began``, of ``time.perf_counter()``, to now; ``waited``: the part spent waiting [s]."""
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
        """Publish if a second has passed; for loops without cycles to count."""
        now = time.perf_counter()
        if now - self._window_start >= self.PERIOD:
            self._publish(now)

    def _publish(self, now: float) -> None:
        if self._count is not None:
            self.rejected, self.drops = self._count()
        state, detail = self._state, self._detail
        if state == "ready" and (flood := "; ".join(filter(None, (each.report() for each in self._floods)))):
            state, detail = "degraded", flood
        elif state == "ready" and not detail and self._freshness is not None:
            detail = self._freshness.report()
        cycles = max(1, self._window_cycles)
        cpu_time = time.process_time()
        statistics = Statistics(
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
        self._publisher.publish(statistics)
        self._cpu_time = cpu_time
        self._reset(now)


def _resident() -> int:
    """Resident memory of this process [B]; without psutil, whose import takes 2 MiB."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


def quiet_collector() -> None:
    """Keep the garbage collector out of a control loop: freeze present objects, and collect rarely.

    Memory freed during startup is returned to the kernel: several MiB in a process with rclpy.
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
