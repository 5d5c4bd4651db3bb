"""What ``valorctl trace`` does: switch the marks of the services on, listen, and say what one period consists of."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from valor.analysis.errors import SignalError
from valor.analysis.lanes import Lane
from valor.analysis.period import Blame, Periods
from valor.analysis.threads import ThreadUse, ThreadWatch
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.trace import FLUSH_PERIOD, Trace, topic
from valor.robot.description import RobotDescription
from valor.valorctl.node import join
from valor.valorctl.presence import require_up

LOOPS = ("comms_manager", "motion_manager", "valor_ros_controller", "bag_recorder")  # that mark their stages
_SWITCHING = 0.5  # until all have begun [s]
_QUEUE = 1000  # messages a service: minutes
_LOOK = 0.05  # between looks at whether somebody wants to stop [s]


@dataclass(frozen=True)
class Tracing:
    """What was seen.

    Attributes:
        cost: what being traced took, of a core, by service [%].
        threads: of all processes, the busiest first.
    """

    seconds: float
    periods: Periods
    ranking: list[Blame]
    cost: dict[str, float]
    threads: list[ThreadUse]

    def as_json(self) -> dict[str, Any]:
        """The object of ``trace --json``; times in seconds."""
        periods = self.periods
        return {
            "seconds": self.seconds,
            "periods": len(periods.length),
            "nominal": periods.nominal,
            "real_time_factor": periods.factor,
            "late_periods": int(np.count_nonzero(periods.late)),
            "period": _percentiles(periods.length),
            "segments": [
                {"title": s.title, **_percentiles(s.duration), "without_core": float(s.without_core.sum())}
                for s in periods.segments
            ],
            "ranking": [asdict(blame) for blame in self.ranking],
            "cost_percent": self.cost,
            "threads": [asdict(use) for use in self.threads],
        }


def trace(instance: Instance, seconds: float, check: Callable[[], None], tell: Callable[[float], None]) -> Tracing:
    """Trace a running instance.

    Args:
        instance: to be traced.
        seconds: how long.
        check: raises when somebody wants to stop.
        tell: told for how long it has listened [s].

    Raises:
        ValorError: it is not up, its Comms Manager says nothing, or the trace shows no periods.
    """
    processes = require_up(instance).processes()
    pids = {name: info.pid for name, info in processes.items() if info.pid}
    nominal = RobotDescription.load(instance.settings().robot, instance.settings().control_rate).control_period
    with join(instance, "valorctl_trace") as node:
        subscribers = {name: node.subscriber(topic(name), Trace, queue=_QUEUE) for name in LOOPS if name in pids}
        _wait(_SWITCHING, check)
        for subscriber in subscribers.values():
            subscriber.drain()
        watch, began = ThreadWatch(pids), time.monotonic()
        while (passed := time.monotonic() - began) < seconds:
            check()
            tell(passed)
            time.sleep(min(_LOOK, seconds - passed))
        threads, ended = watch.use(), time.monotonic()
        _wait(2.0 * FLUSH_PERIOD, check)
        heard = {name: [received.message for received in each.drain()] for name, each in subscribers.items()}
    try:
        lanes = {name: Lane.of(name, heard[name]) for name in LOOPS if heard.get(name)}
        periods = Periods.of(lanes, nominal)
    except SignalError as error:
        raise ValorError(f"{error}; `valorctl status` shows the state of the processes") from None
    cost = {name: 100.0 * lane.cost / (lane.end[-1] - lane.start[0]) for name, lane in lanes.items()}
    return Tracing(ended - began, periods, periods.ranking(), cost, threads)


def _wait(duration: float, check: Callable[[], None]) -> None:
    until = time.monotonic() + duration
    while time.monotonic() < until:
        check()
        time.sleep(_LOOK)


def _percentiles(values: np.ndarray[Any, Any]) -> dict[str, float]:
    median, p99, longest = np.percentile(values, (50, 99, 100))
    return {"median": float(median), "p99": float(p99), "max": float(longest)}
