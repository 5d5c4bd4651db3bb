"""Table 5.1: processor and memory use of every process while the robot stands."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from thesis.analysis.process_statistics import Sampler, Usage, plot, write_csv
from thesis.experiments import background_clients
from thesis.experiments.experiment import Run
from thesis.report.results import Measure, Table
from valor.common.topics import CONTROL_MODE, PROPRIOCEPTOR, STATISTICS, Topic
from valor.valorctl.drive.node import join, next_message
from valor.valorctl.instance.supervision import Supervisor
from valor.valorctl.terminal.console import bar

SECONDS, QUICK = 300.0, 3.0
PERIOD = 0.5  # sampling period [s]
PATIENCE = 10.0  # timeout of a message [s]
_VRC = "valor_ros_controller"
_DOES = {"simulation": "simulates the robot here", "hardware": "speaks to devices, too, which are emulated here"}


@dataclass(frozen=True)
class _Stood:
    """Measurements of a standing robot.

    Attributes:
        usage: by process.
        behaviors: times on the axis of the samples [s], and the behavior at each.
        pace: ratio of robot time to wall clock.
        dropped: messages dropped by the recorder since its start.
    """

    usage: dict[str, Usage]
    behaviors: list[tuple[float, str]]
    pace: float
    dropped: int


def run(run: Run) -> None:
    """Stand for five minutes, and sample every process twice a second."""
    seconds = QUICK if run.options.quick else SECONDS
    bag = run.out / "process_stats.mcap"
    accompanied: _Stood | None = None
    with run.system(bag=bag) as settings:
        alone = _stand(run, _pids(run), seconds)
    if run.options.with_clients:
        run.files.append(run.out / "process_stats_with_clients.mcap")
        with run.system(bag=run.files[-1], page=True), background_clients.working(run) as others:
            accompanied = _stand(run, _pids(run) | others, seconds)
    usage, variant = alone.usage, settings.variant
    run.text = (
        f"The robot stands in control mode stand, arms at its sides, for {seconds:.0f} s, with every process of the "
        f"system running and the recorder recording all. Each process is looked at every {PERIOD:g} s. Percentages "
        "are of one core, as top counts."
    )
    run.tables.append(_table("", usage))
    vrc = usage[_VRC]
    run.measures += [
        Measure("VRC processor, mean", float(vrc.cpu.mean()), "% of one core", "36 simulation, 53 hardware",
                "the same conversions; C++ with a thread a task, 12 and 8 cores there; one Python loop here"),
        Measure("VRC processor, sd", float(vrc.cpu.std()), "% of one core", "8 simulation, 10 hardware",
                "of looks half a second apart; the thesis does not say how far apart its own were"),
        Measure("VRC processor, max", float(vrc.cpu.max()), "% of one core", "100 simulation, 113 hardware",
                "tasks' threads add up there; here only the sockets' work beside the loop"),
        Measure("VRC processor, min", float(vrc.cpu.min()), "% of one core", "13 simulation, 15 hardware",
                "states come at their full rate while the robot stands, in both"),
        Measure("VRC memory, mean", float(vrc.memory.mean()), "MiB", "98.3 hardware",
                "the same size, of other things: here the interpreter, NumPy and rclpy"),
        Measure("Motion System processor, mean",
                float(usage["motion_manager"].cpu.mean() + usage["comms_manager"].cpu.mean()), "% of one core",
                "over 150", f"a core for control there, half of one for devices; the Comms Manager {_DOES[variant]}"),
        Measure("robot time against the wall's", alone.pace, "", "", "below 1 on a computer too busy for the "
                "plant: percentages are as much lower"),
        Measure("recorder processor, mean", float(usage["bag_recorder"].cpu.mean()), "% of one core", "",
                "every message of every topic, at the control rate"),
        Measure("recorder, messages dropped", float(alone.dropped), "", "", "of all topics, since it began"),
        Measure("whole system, mean", float(np.sum([one.cpu.mean() for one in usage.values()])), "% of one core"),
    ]  # fmt: skip
    if accompanied is not None:
        _tell(run, accompanied)
    run.files += [bag, write_csv(usage, run.out / "process_stats.csv")]
    behavior = (np.array([at for at, _ in alone.behaviors]), np.array([name for _, name in alone.behaviors]))
    run.picture([plot(usage, behavior, run.out / "process_stats.png")],
                "Processor and memory of every process over time; below, what the Motion System did.")  # fmt: skip


def _tell(run: Run, stood: _Stood) -> None:
    """Add table 5.1 with clients that work with the robot."""
    run.text += (
        " Then a system as long with both ends of a link and the operator's page behind it, with an operator's client, "
        "which hears joints, transforms, forces and states at full rate, and a planner of an arm's ways and of steps."
    )
    run.tables.append(_table(", with the page behind a link, an operator's client and a planner", stood.usage))
    run.measures += [
        Measure("VRC processor, mean, with others", float(stood.usage[_VRC].cpu.mean()), "% of one core",
                "36 simulation, 53 hardware", "the page behind a link, an operator's client and a planner beside it"),
        Measure("robot time against the wall's, with others", stood.pace, "", "", "likewise"),
        Measure("recorder, messages dropped, with others", float(stood.dropped), "", "", "of all topics, likewise"),
    ]  # fmt: skip
    run.files.append(write_csv(stood.usage, run.out / "process_stats_with_clients.csv"))


def _pids(run: Run) -> dict[str, int]:
    return {name: info.pid for name, info in Supervisor(run.instance).processes().items() if info.pid}


def _stand(run: Run, pids: Mapping[str, int], seconds: float) -> _Stood:
    """Sample processes for some seconds."""
    behaviors: list[tuple[float, str]] = []
    with join(run.instance, "experiment") as node:
        reports = CONTROL_MODE.subscriber(node, queue=1000)
        sampler = Sampler(pids)
        began, robot_time = time.monotonic(), _robot_time(run)
        with bar("standing", seconds, "s") as shown:
            while (elapsed := time.monotonic() - began) < seconds:
                time.sleep(max(0.0, PERIOD - elapsed % PERIOD))
                sampler.sample()
                behaviors += [(1e-9 * each.stamp - sampler.began, each.message.behavior) for each in reports.drain()]
                shown(elapsed)
                run.interruption.check()
        pace = (_robot_time(run) - robot_time) / (time.monotonic() - began)
        dropped = _hear(run, STATISTICS["bag_recorder"]).drops
    return _Stood(sampler.usage(), behaviors, pace, dropped)


def _table(suffix: str, usage: Mapping[str, Usage]) -> Table:
    columns = ["process", "mean", "sd", "max", "min", "memory mean", "memory max"]
    title = f"Processor [% of one core] and memory [MiB]{suffix}"
    return Table(title, columns, [_row(name, one) for name, one in usage.items()])


def _hear(run: Run, topic: Topic[Any]) -> Any:
    """Wait for the next message of a topic."""
    with join(run.instance, "experiment") as node:
        return next_message(topic, topic.subscriber(node), PATIENCE)


def _robot_time(run: Run) -> float:
    return 1e-9 * float(_hear(run, PROPRIOCEPTOR).time)


def _row(name: str, one: Usage) -> list[str]:
    cpu = (one.cpu.mean(), one.cpu.std(), one.cpu.max(), one.cpu.min())
    return [name, *(f"{value:.1f}" for value in (*cpu, one.memory.mean(), one.memory.max()))]
