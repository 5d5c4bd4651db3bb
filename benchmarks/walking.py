"""How well ESCHER walks: the whole system's real processes, plant and model different, an observer outside.

Each run starts a system of its own (``valorctl up``; lockstep, as fast as it goes unless --rtf says otherwise, so that
the machine's load slows the clock and not the robot), does what its row says and listens. Rows are the table ``ROWS``.
With --json every run is kept as soon as it is over, and one that is there already is not made again: a table that was
interrupted goes on where it was.

    .venv/bin/python benchmarks/walking.py [--rows flat_0.5 dirt …] [--seeds 0 1 2] [--quick] [--json FILE]
"""

from __future__ import annotations

import argparse
import math
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Protocol, Self

import msgspec
import yaml
from flights import over_stairs
from live_system import System, running
from rich.console import Console
from rich.table import Table

from valor_analysis.errors import BagError
from valor_analysis.walk import Figures
from valor_common import worlds
from valor_common.errors import ValorError
from valor_common.instance import Instance
from valor_common.robot import RobotDescription
from valor_common.worlds.stairs import Stairs
from valorctl import stepping
from valorctl.step_plan import PlanStep
from valorctl.walking import MODES, Order, walk

STANDING = (-0.012, 0.1)  # x and |y| of the soles at the start [m]
STEP = 0.25  # length on a floor taken for flat [m]
ROBOT = Path(__file__).parents[1] / "robots" / "escher"
QUICK_SECONDS, QUICK_DISTANCE, QUICK_PUSHES = 5.0, 2.0, 2  # of a run with --quick
QUICK_ROWS = ("flat_0.5", "dirt", "about", "rubble")


class Action(Protocol):
    """What a run does. It says what went wrong beside falling; nothing: it did what it was to do."""

    def __call__(self, system: System, seed: int) -> str: ...

    @property
    def quick(self) -> Self:
        """The same, shorter."""


@dataclass(frozen=True)
class Velocity:
    """Walk by velocity, as ``valorctl walk`` does."""

    order: Order

    def __call__(self, system: System, seed: int) -> str:
        result = walk(system.instance, self.order, system.observer.hear)
        wanted = self.order.distance
        return result.reason or ("did not get there" if wanted and result.distance < 0.98 * wanted else "")

    @property
    def quick(self) -> Self:
        order = self.order
        if order.distance is not None:
            return replace(self, order=replace(order, distance=QUICK_DISTANCE))
        return replace(self, order=replace(order, seconds=QUICK_SECONDS))


@dataclass(frozen=True)
class InTurn:
    """Several walks, one after the other."""

    walks: tuple[Velocity, ...]

    def __call__(self, system: System, seed: int) -> str:
        for each in self.walks:
            if failure := each(system, seed):
                return f"{failure} (after {each.order})"
        return ""

    @property
    def quick(self) -> Self:
        return replace(self, walks=tuple(each.quick for each in self.walks[:2]))


@dataclass(frozen=True)
class Plan:
    """Take the steps of a plan in odom, as ``valorctl step`` does: over ROS and the Footstep Converter."""

    steps: Callable[[], list[PlanStep]]

    def __call__(self, system: System, seed: int) -> str:
        outcome = stepping.step_plan(system.instance, self.steps(), stepping.ODOM, system.observer.hear)
        system.observer.wait(lambda state: state.behavior == "fall", 1.0)
        state = system.observer.state
        return f"{state.behavior}: {state.reason}" if state.behavior == "fall" else outcome.reason

    @property
    def quick(self) -> Self:
        steps = self.steps()
        return replace(self, steps=lambda: steps[: round(QUICK_DISTANCE / STEP)])


@dataclass(frozen=True)
class Pushes:
    """Push the robot again and again, standing or walking by velocity, one direction after the other."""

    impulses: tuple[tuple[float, float], ...]  # one after the other: how much [N·s], from x anticlockwise [rad]
    count: int = 8
    forward: float = 0.0  # walking so meanwhile [m/s]; 0: standing
    every: float = 4.0  # [robot time, s]

    def __call__(self, system: System, seed: int) -> str:
        if self.forward:
            return self._walking(system, seed)
        for k in range(self.count):
            system.push(self._impulse(k))
            if system.observer.wait(lambda state: state.behavior == "fall", self.every):
                return f"fall: {system.observer.state.reason} (push {k + 1}, {self._name(k)})"
        return ""

    def _walking(self, system: System, seed: int) -> str:
        pushed = 0
        start = system.observer.state.time
        first = 5.0 + seed * self.every / 7.0  # at full speed; each seed has phases of its own

        def hear() -> None:
            nonlocal pushed
            system.observer.hear()
            state = system.observer.state
            due = 1e-9 * (state.time - start) > first + pushed * self.every
            if due and pushed < self.count and state.behavior in MODES:
                system.push(self._impulse(pushed + 3 * seed))
                pushed += 1

        seconds = first + 1.0 + self.count * self.every
        result = walk(system.instance, Order(forward=self.forward, seconds=seconds, straight=True), hear)
        last = self._name(pushed - 1 + 3 * seed)
        return f"{result.reason} (push {pushed}, {last})" if result.reason else ""

    def _impulse(self, k: int) -> tuple[float, float, float]:
        impulse, direction = self.impulses[k % len(self.impulses)]
        return impulse * math.cos(direction), impulse * math.sin(direction), 0.0

    def _name(self, k: int) -> str:
        impulse, direction = self.impulses[k % len(self.impulses)]
        return f"{impulse:g} N·s at {math.degrees(direction):.0f}°"

    @property
    def quick(self) -> Self:
        return replace(self, count=QUICK_PUSHES)


def along_axes(forward: float, back: float, side: float) -> tuple[tuple[float, float], ...]:
    """Impulses for ``Pushes``: forward, back, left, right [N·s]."""
    return (forward, 0.0), (back, math.pi), (side, math.pi / 2), (side, -math.pi / 2)


def all_around(impulse: float, directions: int = 8) -> tuple[tuple[float, float], ...]:
    """Impulses for ``Pushes``: one after another, all around [N·s]."""
    turn = 2.0 * math.pi / directions
    return tuple((impulse, math.remainder(3 * k * turn, 2.0 * math.pi)) for k in range(directions))


@dataclass(frozen=True)
class Stand:
    """Stand still."""

    seconds: float  # [robot time, s]

    def __call__(self, system: System, seed: int) -> str:
        fell = system.observer.wait(lambda state: state.behavior == "fall", self.seconds)
        return f"fall: {system.observer.state.reason}" if fell else ""

    @property
    def quick(self) -> Self:
        return replace(self, seconds=QUICK_SECONDS)


def climb(name: str) -> Callable[[], list[PlanStep]]:
    """Steps over a world of stairs."""

    def steps() -> list[PlanStep]:
        stairs = worlds.WORLDS[name]
        assert isinstance(stairs, Stairs)
        return over_stairs(RobotDescription.load(ROBOT).tables, stairs)

    return steps


def straight_on(distance: float) -> Callable[[], list[PlanStep]]:
    """Steps of one length on a floor taken for flat."""

    def steps() -> list[PlanStep]:
        count = math.ceil(distance / STEP)
        places = [(STANDING[0] + min(distance, (i + 1) * STEP), 0.0) for i in range(count)]
        return _alternating([*places, places[-1]])

    return steps


def _alternating(places: list[tuple[float, float]]) -> list[PlanStep]:
    """Left and right in turn at places (x, z)."""
    y = (STANDING[1], -STANDING[1])
    return [PlanStep(foot="right" if i % 2 else "left", x=x, y=y[i % 2], z=z) for i, (x, z) in enumerate(places)]


@dataclass(frozen=True)
class Row:
    """What is measured: a world, an action, how many seeds unless told otherwise."""

    world: str
    seeds: int
    action: Action
    note: str
    tables: dict[str, dict[str, object]] | None = None  # of robot.yaml, that are other than the robot's


def _by(forward: float = 0.0, left: float = 0.0, turn: float = 0.0, seconds: float = 30.0) -> Velocity:
    return Velocity(Order(forward, left, turn, seconds))


def _course(speed: float, distance: float = 61.0) -> Velocity:
    return Velocity(Order(speed, distance=distance, straight=True))


# A step every 0.66 s at 0.3 m/s: pushes 2.618 times two of them apart come at phases that spread by themselves.
SPREAD = 2.618 * 1.326  # [robot time, s]
FEET_FIXED: dict[str, dict[str, object]] = {"disturbance": {"step_when_standing": False}}
AT_BOUND = along_axes(25.6, 25.6, 35.7)  # 80 % of m·ω·Δξ, as `control.py fixed` prints it [N·s]

ABOUT = (
    _by(turn=0.4, seconds=8.0), _by(left=0.125, seconds=8.0), _by(-0.25, seconds=8.0), _by(0.3, 0.08, 0.2, seconds=8.0),
)  # fmt: skip

# fmt: off
ROWS: dict[str, Row] = {
    "flat_0.5":        Row("flat",        5, _by(0.5),                              "0.5 m/s for 30 s"),
    "flat_0.8":        Row("flat",        5, _by(0.8),                              "0.8 m/s for 30 s"),
    "dirt":            Row("dirt",        3, _course(0.45),                         "61 m at 0.45 m/s"),
    "about":           Row("flat",        3, InTurn(ABOUT),                         "turn, aside, back, blended"),
    "stairs":          Row("stairs",      3, Plan(climb("stairs")),                 "3 × 10 cm up and down"),
    "stairs_15cm":     Row("stairs_15cm", 5, Plan(climb("stairs_15cm")),            "3 × 15 cm up and down"),
    "rubble":          Row("rubble",      5, Plan(straight_on(3.5)),                "3.5 m, planned flat"),
    "push_fixed":      Row("flat",        3, Pushes(AT_BOUND),                      "80 % of m·ω·Δξ", FEET_FIXED),
    "push_stepping":   Row("flat",        3, Pushes(along_axes(40.0, 40.0, 35.0)),  "40, 40, 35 N·s, twice"),
    "push_walking":    Row("flat",        3, Pushes(all_around(15.0), 16, 0.3, SPREAD), "16 of 15 N·s at 0.3 m/s"),
    "push_walking_25": Row("flat",        3, Pushes(all_around(25.0), 16, 0.3, SPREAD), "16 of 25 N·s at 0.3 m/s"),
    "stand":           Row("flat",        3, Stand(60.0),                           "60 s"),
}
# fmt: on


@dataclass(frozen=True)
class Run:
    """What one run gave."""

    row: str
    seed: int
    actuators: str
    clock: str
    quick: bool
    failure: str  # empty: it did what it was to do
    way: tuple[float, float, float]  # true: forward, left [m], turned [rad]
    figures: Figures
    timeliness: dict[str, float]
    lost: int  # messages that the observer missed
    load: float  # of the machine


def measure(home: Path, name: str, seed: int, arguments: argparse.Namespace, tell: Callable[[str], None]) -> Run:
    """Start a system, do what the row says, and stop it.

    Raises:
        ValorError: it does not start.
    """
    row = ROWS[name]
    bags = home / "bags"
    bags.mkdir(exist_ok=True)
    options: dict[str, object] = {
        "world": row.world, "seed": seed, "actuators": arguments.actuators, "clock": arguments.clock,
        "rtf": arguments.rtf, "bag": bags / "run.mcap",
    }  # fmt: skip
    if row.tables:
        options["robot"] = robot_with(row.tables, home)
    try:
        with running(Instance(f"walking-{seed}", home), options, tell) as system:
            try:
                failure = (row.action.quick if arguments.quick else row.action)(system, seed)
            except ValorError as error:
                failure = str(error)
            observer = system.observer
            observer.hear()
    finally:
        for bag in bags.iterdir():
            bag.unlink()
    track = observer.track()
    try:
        first, last = track.walk()
    except BagError:  # a row that stands
        first, last = float(track.time[0]), float(track.time[-1])
    return Run(
        name, seed, arguments.actuators, arguments.clock, arguments.quick, failure, observer.way(),
        Figures.of(track.between(first, last)), observer.timeliness(), observer.lost, os.getloadavg()[0],
    )  # fmt: skip


def robot_with(tables: dict[str, dict[str, object]], folder: Path) -> Path:
    """A copy of the robot with values of some tables replaced."""
    robot = folder / "robot"
    if not robot.exists():
        shutil.copytree(ROBOT, robot)
    path = robot / "robot.yaml"
    content = yaml.safe_load((ROBOT / "robot.yaml").read_text())
    for table, values in tables.items():
        content[table] = {**content.get(table, {}), **values}
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return robot


def show(runs: list[Run], console: Console) -> None:
    """One table, a line a run."""
    table = Table(title=f"Walking at 500 Hz, {os.cpu_count()} cores")
    for heading in ("row", "seed", "result", "true x, y [m]", "turned", "time [s]", "speed", "DCM rms x, y, z [mm]",
                    "knee", "clamped", "Fz rms / median [N]", "QP failures", "tick / p99 [ms]", "missed", "timed out",
                    "slip [s]", "RTF", "load"):  # fmt: skip
        table.add_column(heading, justify="left" if heading in ("row", "result") else "right")
    for run in runs:
        x, y, turned = run.way
        f, late = run.figures, run.timeliness
        table.add_row(
            run.row,
            str(run.seed),
            run.failure or "ok",
            f"{x:.2f}, {y:.2f}",
            f"{turned:.2f}",
            f"{f.duration:.1f}",
            f"{f.speed:.2f}",
            ", ".join(f"{1e3 * each:.0f}" for each in f.dcm_error),
            f"{f.knee:.2f}",
            str(f.saturations),
            f"{f.force_error:.0f} / {f.force_error_median:.1f}",
            str(f.qp_failures),
            f"{1e3 * f.tick_median:.2f} / {1e3 * f.tick_99:.2f}",
            f"{late['overruns']:.0f}",
            f"{late['waits_timed_out']:.0f}",
            f"{late['slip']:.2f}",
            f"{late['real_time_factor']:.2f}",
            f"{run.load:.1f}",
        )
    console.print(table)


def summary(runs: list[Run]) -> Iterator[str]:
    """Markdown, a line a row: the worst run of each."""
    yield (
        "| run | as ordered | robot time [s] | DCM error, RMS in x, y, z [mm] | smallest knee angle [rad] "
        "| torques at their limit | planned vs felt foot force, RMS [N] | QP failures | ticks beyond 2 ms | slip [s] |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for name, group in groupby(runs, lambda run: run.row):
        each = list(group)
        figures = [run.figures for run in each]
        errors = [_span([1e3 * f.dcm_error[i] for f in figures], 0) for i in range(3)]
        late = sum(run.timeliness["overruns"] for run in each) / sum(f.ticks for f in figures)
        yield (
            f"| {name}: {ROWS[name].note} | {sum(not run.failure for run in each)} of {len(each)} "
            f"| {_span([f.duration for f in figures], 1)} | {', '.join(errors)} | {min(f.knee for f in figures):.2f} "
            f"| {_span([f.saturations for f in figures], 0)} | {_span([f.force_error for f in figures], 0)} "
            f"| {sum(f.qp_failures for f in figures)} | {100.0 * late:.1f} % "
            f"| {_span([run.timeliness['slip'] for run in each], 2)} |"
        )


def _span(values: list[float], digits: int) -> str:
    """Smallest and largest, or the one that both are."""
    low, high = (f"{end:.{digits}f}" for end in (min(values), max(values)))
    return low if low == high else f"{low}–{high}"


def cases(arguments: argparse.Namespace) -> Iterator[tuple[str, int]]:
    """Rows and seeds that are asked for."""
    for name in arguments.rows or (QUICK_ROWS if arguments.quick else ROWS):
        seeds = arguments.seeds or range(1 if arguments.quick else ROWS[name].seeds)
        yield from ((name, seed) for seed in seeds)


class Teller:
    """Says how a run goes on: in one line on a terminal, else in a line now and then."""

    EVERY = 20.0  # between lines [s]

    def __init__(self, console: Console, what: str) -> None:
        self._console, self._what = console, what
        self._status = console.status(what)
        self._due = time.monotonic() + self.EVERY

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._status.stop()

    def __call__(self, where: str) -> None:
        if self._console.is_terminal:
            self._status.update(f"{self._what}: {where}")
        elif time.monotonic() > self._due:
            self._due = time.monotonic() + self.EVERY
            print(f"  {self._what}: {where}", flush=True)


def main() -> None:
    """Measure, print, keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", nargs="+", choices=list(ROWS), metavar="ROW", help=", ".join(ROWS))
    parser.add_argument("--seeds", type=int, nargs="+", help="instead of each row's own number of them")
    parser.add_argument("--quick", action="store_true", help="few rows, one seed, some seconds or metres each")
    parser.add_argument("--actuators", default="hardware", choices=("ideal", "hardware"))
    parser.add_argument("--clock", default="lockstep", choices=("lockstep", "realtime"))
    parser.add_argument("--rtf", type=float, default=0.0, help="real-time factor of lockstep; 0: as fast as it goes")
    parser.add_argument("--json", type=Path, help="where every run is kept, and looked up")
    arguments = parser.parse_args()
    console = Console(width=None if sys.stdout.isatty() else 220)
    runs: list[Run] = []
    if arguments.json and arguments.json.exists():
        runs = msgspec.json.decode(arguments.json.read_bytes(), type=list[Run])
    like = (arguments.actuators, arguments.clock, arguments.quick)
    made = {(run.row, run.seed) for run in runs if (run.actuators, run.clock, run.quick) == like}
    left = [case for case in cases(arguments) if case not in made]
    with tempfile.TemporaryDirectory(prefix="valor-") as home:
        for number, (name, seed) in enumerate(left, start=1):
            began = time.monotonic()
            what = f"{name} ({ROWS[name].note}), seed {seed}, run {number} of {len(left)}"
            try:
                with Teller(console, what) as tell:
                    run = measure(Path(home), name, seed, arguments, tell)
            except ValorError as error:
                sys.exit(f"{name}, seed {seed}: {error}")
            runs.append(run)
            print(f"{what}: {run.failure or 'ok'}; {time.monotonic() - began:.0f} s", flush=True)
            if arguments.json:
                keep(runs, arguments.json)
    order = list(ROWS)
    runs.sort(key=lambda run: (order.index(run.row), run.seed))
    show(runs, console)
    print(*summary(runs), sep="\n")


def keep(runs: list[Run], path: Path) -> None:
    """Write all runs; whoever is interrupted meanwhile has the file as it was."""
    new = path.with_suffix(".new")
    new.write_bytes(msgspec.json.format(msgspec.json.encode(runs), indent=1) + b"\n")
    new.replace(path)


if __name__ == "__main__":
    main()
