"""Health of the processes of an instance: supervisord's state of a process combined with the process's own reports.

A process is ready while supervisord reports it as running and its own reports, with the same pid, say so. bifrostd
reports by replying to requests; the services publish ``Statistics``.
"""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self

import bifrost
from valor.common.instance import Instance
from valor.common.messages import Statistics
from valor.common.processes import DAEMON
from valor.common.topics import STATISTICS
from valor.valorctl.instance.supervision import ProcessInfo, ProcessState

REPORT_TIMEOUT = 3.0  # without a report, after which a process is not ready [s]
START_GRACE = 10.0  # from the start of a process to its first report [s]

State = Literal["starting", "ready", "degraded", "stopped", "failed"]


@dataclass(frozen=True)
class ProcessReport:
    """The latest report of a process about itself, received at a time [``time.monotonic()``, s]."""

    pid: int
    state: str
    detail: str
    cpu_percent: float
    memory_mib: float
    received: float


@dataclass(frozen=True)
class Health:
    """Health of one process."""

    name: str  # of the process
    state: State  # see ``State``
    pid: int  # 0 if it does not run
    cpu_percent: float | None  # of one core, over the last second; None if unavailable
    memory_mib: float | None  # [MiB]; None if unavailable
    restarts: int  # number of unexpected ends
    detail: str  # what the process waits for, or what is wrong


def judge(
    info: ProcessInfo, report: ProcessReport | None, now: float, restarts: int = 0, paused: bool = False
) -> Health:
    """Combine supervisord's information with the latest report, if any; ``now``: ``time.monotonic()`` [s].

    ``paused``: robot time is, so that a process that runs and waits for the robot is ready.
    """
    if report is not None and report.pid != info.pid:
        report = None  # from an earlier run of the process
    state, detail = _state(info, report, now)
    if paused and info.state is ProcessState.RUNNING and state in ("starting", "failed"):
        state, detail = "ready", "robot time is paused"
    return Health(
        name=info.name,
        state=state,
        pid=info.pid,
        cpu_percent=report.cpu_percent if report else None,
        memory_mib=report.memory_mib if report else None,
        restarts=restarts,
        detail=detail,
    )


def _state(info: ProcessInfo, report: ProcessReport | None, now: float) -> tuple[State, str]:
    match info.state:
        case ProcessState.STOPPED:
            return "stopped", ""
        case ProcessState.STOPPING:
            return "stopped", "stopping"
        case ProcessState.EXITED:
            return "failed", f"ended with exit status {info.exit_status}"
        case ProcessState.FATAL | ProcessState.UNKNOWN | ProcessState.BACKOFF:
            return "failed", info.problem or "cannot be started"
    if report is None:
        if info.uptime <= START_GRACE:
            return "starting", "no report yet"
        return "failed", f"runs, but no report in {info.uptime:.0f} s"
    if (age := now - report.received) > REPORT_TIMEOUT:
        return "failed", f"runs, but no report for {age:.1f} s"
    if report.state in ("ready", "degraded"):
        return ("ready" if report.state == "ready" else "degraded"), report.detail
    if report.state == "stopping":
        return "stopped", "stopping"
    return "starting", report.detail


class Listener:
    """Receives the processes' reports; ``reports``: the latest of each process. Not thread-safe."""

    def __init__(self, instance: Instance, names: Iterable[str]) -> None:
        """Subscribe. Raises ``bifrost.ConfigurationError``: network or keys are not readable."""
        self._network = bifrost.Network.load(instance.network_file, instance.keys)
        self.node = bifrost.Node("valorctl", network=self._network)
        self._names = tuple(names)
        self._subscribers = [STATISTICS[name].subscriber(self.node) for name in self._names if name in STATISTICS]
        self.reports: dict[str, ProcessReport] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the network."""
        self.node.close()

    def listen(self, timeout: float, others: Sequence[bifrost.Subscriber[Any]] = ()) -> None:
        """Receive for up to ``timeout`` [s]; returns after the first messages, also of other subscribers."""
        if DAEMON in self._names:
            self._query_daemon()
        for subscriber in bifrost.wait([*self._subscribers, *others], timeout=timeout):
            received = subscriber.latest() if subscriber in self._subscribers else None
            if received is None:
                continue
            found: Statistics = received.message
            self.reports[found.service] = ProcessReport(
                found.pid, found.state, found.detail, found.cpu_percent, found.memory_mib, received.stamp * 1e-9
            )

    def expected(self, names: Iterable[str]) -> set[str]:
        """Those of some processes whose report may still arrive: not without a publisher in the network."""
        names = set(names)
        if not names or not self.node.discovery.registered:
            return names
        topics = self.node.graph().topics

        def published(name: str) -> bool:
            topic = topics.get(STATISTICS[name].name)
            return topic is not None and bool(topic.publishers)

        return {name for name in names if name not in STATISTICS or published(name)}

    def _query_daemon(self) -> None:
        report = self.reports.get(DAEMON)
        if report is not None and time.monotonic() - report.received < 0.5 * REPORT_TIMEOUT:
            return
        if info := bifrost.daemon_alive(self._network, timeout=0.2):
            self.reports[DAEMON] = ProcessReport(
                info.pid, "ready", info.refusal, info.cpu_percent, info.memory_mib, time.monotonic()
            )
