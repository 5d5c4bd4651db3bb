"""Table 5.1: processor and memory use of every process while the robot stands."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from thesis.analysis import rates
from thesis.analysis.process_statistics import Sampler, Usage, plot, write_csv
from thesis.experiments import background_clients
from thesis.experiments.background_clients import BROWSER
from thesis.experiments.experiment import Run
from thesis.experiments.pathway_latency import vrc_rate
from thesis.report.results import Measure, Table
from valor.common.processes import SENSORS
from valor.common.resources import robot_folder
from valor.common.topics import CONTROL_MODE, PROPRIOCEPTOR, STATISTICS, Topic
from valor.robot.description import RobotDescription
from valor.valorctl.drive.node import join, next_message
from valor.valorctl.instance.supervision import Supervisor
from valor.valorctl.terminal.console import bar

if TYPE_CHECKING:
    from valor.common.instance import Settings

SECONDS, BESIDE, QUICK = 120.0, 40.0, 3.0  # as in the thesis' table; of what it has not
PERIOD = 0.5  # sampling period [s]
PATIENCE = 10.0  # timeout of a message [s]
_VRC = "valor_ros_controller"
_SIMULATION, _OTHER_ROBOT = "sim", "thor"
_THESIS = {  # table 5.1: simulation, hardware; and why ours differ
    "VRC processor, mean": ("36", "53", "the same conversions; C++ with a thread a task, on 12 and 8 cores there"),
    "VRC processor, sd": ("8", "10", f"of samples {PERIOD:g} s apart; theirs are not given"),
    "VRC processor, max": ("100", "113", "threads add up there; here only the sockets' work beside the loop"),
    "VRC processor, min": ("13", "15", ""),
    "VRC memory [MiB]": ("–", "98.3", "here the interpreter, NumPy and rclpy"),
    "Motion System processor": ("over 150", "over 150", "a core for control there, half of one for devices"),
}


@dataclass(frozen=True)
class _Condition:
    """What runs: a system, and what is beside it."""

    name: str  # of files
    title: str
    profile: str
    seconds: float
    robot: str | None = None  # None: that of the command line
    others: bool = False  # the page behind a link, and clients
    sensors: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Stood:
    """Measurements of a standing robot.

    Attributes:
        usage: by process.
        behaviors: times on the axis of the samples [s], and the behavior at each.
        pace: ratio of robot time to wall clock.
        dropped: messages dropped by the recorder since its start.
        asked: rates asked for by name [Hz].
        came: rates achieved, likewise.
    """

    usage: dict[str, Usage]
    behaviors: list[tuple[float, str]]
    pace: float
    dropped: int
    asked: dict[str, float]
    came: dict[str, float]

    @property
    def services(self) -> list[Usage]:
        """Of the robot's processes, without clients."""
        return [one for name, one in self.usage.items() if name not in (*background_clients.ROLES, BROWSER)]


def run(run: Run) -> None:
    """Stand, and sample every process twice a second: in simulation and on devices, then with what is beside them."""
    conditions = _conditions(run)
    found = {each.title: _measure(run, each) for each in conditions}
    own = next(each.title for each in conditions if each.profile == run.options.profile)
    stood = found[own]
    run.text = (
        "The robot stands in control mode stand, arms at its sides, with every process of the system running and the "
        f"recorder recording all: {', '.join(f'{each.title} {each.seconds:.0f} s' for each in conditions)}. Each "
        f"process is sampled every {PERIOD:g} s. Percentages are of one core, as top counts; where robot time is not "
        "the wall's, those per robot second tell what a computer that keeps up would spend."
    )
    if any(each.others for each in conditions):
        browser = f"a browser that looks at it ({BROWSER}, at a low priority, as if on another computer)"
        if not any(BROWSER in each.usage for each in found.values()):
            browser = f"no browser, for this computer has none ({BROWSER})"
        run.text += (
            f" With others: both ends of a link and the operator's page behind it, {browser}, an operator's client, "
            "which hears joints, transforms, forces and states at full rate, and a planner of an arm's ways and of "
            "steps."
        )
    run.tables += [_table(found), _processes(found)]
    run.measures += [
        Measure("VRC processor, mean", float(stood.usage[_VRC].cpu.mean()), "% of one core",
                "36 simulation, 53 hardware", "; ".join(f"{name} {one.usage[_VRC].cpu.mean():.1f}, "
                f"{one.usage[_VRC].cpu.mean() / one.pace:.1f} a robot second" for name, one in found.items())),
        Measure("Motion System processor, mean", float(_motion_system(stood)), "% of one core", "over 150",
                "; ".join(f"{name} {_motion_system(one):.1f}" for name, one in found.items())),
        Measure("robot time against the wall's", stood.pace, "", "", f"{own}; below 1 on a computer too busy"),
    ]  # fmt: skip
    for each in conditions:
        run.files.append(write_csv(found[each.title].usage, run.out / f"process_stats_{each.name}.csv"))
    behavior = (np.array([at for at, _ in stood.behaviors]), np.array([name for _, name in stood.behaviors]))
    caption = f"Processor and memory of every process over time, {own}; below, what the Motion System did."
    run.picture([plot(stood.usage, behavior, run.out / "process_stats.png")], caption)


def _conditions(run: Run) -> list[_Condition]:
    """The thesis' two, of them only the command line's in a short run; with clients also what it has not."""
    options = run.options
    names = {_SIMULATION: "simulation"}
    profiles = [options.profile] if options.quick else list(dict.fromkeys([_SIMULATION, options.profile]))
    seconds = QUICK if options.quick else SECONDS
    made = [_Condition(each, names.get(each, each), each, seconds) for each in profiles]
    if options.with_clients:
        seconds = QUICK if options.quick else BESIDE
        sensors = tuple(SENSORS)
        made += [  # in simulation, for emulated devices leave too little of two cores
            _Condition("others", "simulation, with others", _SIMULATION, seconds, others=True),
            _Condition("sensors", f"simulation, {', '.join(sensors)}", _SIMULATION, seconds, sensors=sensors),
            _Condition("robot", f"simulation, {_OTHER_ROBOT}", _SIMULATION, seconds, _OTHER_ROBOT),
        ]
    return made


def _measure(run: Run, condition: _Condition) -> _Stood:
    """Measure one system."""
    bag = run.out / f"process_stats_{condition.name}.mcap"
    run.files.append(bag)
    robot = robot_folder(condition.robot) if condition.robot else None
    before = len(run.rates)
    with run.system(bag=bag, profile=condition.profile, robot=robot, page=condition.others,
                    sensors=condition.sensors) as settings:  # fmt: skip
        asked = _asked(run, settings)
        with ExitStack() as stack:
            others = stack.enter_context(background_clients.working(run)) if condition.others else {}
            stood = _stand(run, _pids(run) | others, condition.seconds)
    came = run.rates[before] if len(run.rates) > before else {}
    return _Stood(*stood, asked, came)


def _asked(run: Run, settings: Settings) -> dict[str, float]:
    """Rates asked for: a Motor a control tick, joint states an update of the VRC [Hz]."""
    from valor.valorctl.drive.ros_client import RosClient

    control = RobotDescription.load(settings.robot, settings.control_rate).tables.control_rate
    with RosClient(run.instance, run.interruption.check) as ros:
        return dict(zip(rates.RATED.values(), (control, control, vrc_rate(ros, settings)), strict=True))


def _pids(run: Run) -> dict[str, int]:
    return {name: info.pid for name, info in Supervisor(run.instance).processes().items() if info.pid}


def _stand(
    run: Run, pids: Mapping[str, int], seconds: float
) -> tuple[dict[str, Usage], list[tuple[float, str]], float, int]:
    """Sample processes for some seconds; returns usage, behaviors, pace and dropped messages."""
    behaviors: list[tuple[float, str]] = []
    with join(run.instance, "experiment") as node:
        reports = CONTROL_MODE.subscriber(node, queue=1000)
        sampler = Sampler(pids, families=(BROWSER,))
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
    return sampler.usage(), behaviors, pace, dropped


def _table(found: Mapping[str, _Stood]) -> Table:
    """Table 5.1, with a column a condition."""
    rows: dict[str, list[str]] = {}
    for one in found.values():
        vrc = one.usage[_VRC]
        shown = {
            "VRC processor, mean": vrc.cpu.mean(), "VRC processor, sd": vrc.cpu.std(),
            "VRC processor, max": vrc.cpu.max(), "VRC processor, min": vrc.cpu.min(),
            "VRC processor a robot second": vrc.cpu.mean() / one.pace, "VRC memory [MiB]": vrc.memory.mean(),
            "Motion System processor": _motion_system(one),
            "Motion System processor a robot second": _motion_system(one) / one.pace,
            "whole system": np.sum([each.cpu.mean() for each in one.services]),
        }  # fmt: skip
        cells = {name: f"{value:.1f}" for name, value in shown.items()} | {
            "robot time against the wall's": f"{one.pace:.3f}", "recorder, messages dropped": str(one.dropped),
        }  # fmt: skip
        for name, rate in one.asked.items():
            came = f"{one.came[name]:.0f}" if name in one.came else "–"
            cells[f"{name}, asked for and came [Hz]"] = f"{rate:.0f}, {came}"
        for name, cell in cells.items():
            rows.setdefault(name, []).append(cell)
    nothing = ("–", "–", "")
    made = [[name, *_THESIS.get(name, nothing)[:2], *cells, _THESIS.get(name, nothing)[2]]
            for name, cells in rows.items()]  # fmt: skip
    columns = ["", "thesis, simulation", "thesis, hardware", *found, "what differs, and why"]
    return Table("Table 5.1: processors [% of one core]", columns, made)


def _processes(found: Mapping[str, _Stood]) -> Table:
    """Every process of every condition."""
    names = list(dict.fromkeys(name for one in found.values() for name in one.usage))
    rows = [[name, *(_cell(one.usage.get(name)) for one in found.values())] for name in names]
    return Table("Every process: processor, mean [% of one core], and memory, largest [MiB]", ["process", *found], rows)


def _cell(one: Usage | None) -> str:
    return "–" if one is None else f"{one.cpu.mean():.1f}, {one.memory.max():.0f}"


def _motion_system(stood: _Stood) -> float:
    return float(stood.usage["motion_manager"].cpu.mean() + stood.usage["comms_manager"].cpu.mean())


def _hear(run: Run, topic: Topic[Any]) -> Any:
    """Wait for the next message of a topic."""
    with join(run.instance, "experiment") as node:
        return next_message(topic, topic.subscriber(node), PATIENCE)


def _robot_time(run: Run) -> float:
    return 1e-9 * float(_hear(run, PROPRIOCEPTOR).time)
