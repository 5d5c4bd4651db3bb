"""How well ESCHER walks: the whole system's real processes, plant and model different, an observer outside.

Each run starts a system of its own (``valorctl up``; lockstep, as fast as it goes unless --rtf says otherwise, so that
the machine's load slows the clock and not the robot), does what its row says and listens. Rows are the table ``ROWS``.
With --json every run is kept as soon as it is over, and one that is there already is not made again: a table that was
interrupted goes on where it was.

    .venv/bin/python benchmarks/walking.py [--rows flat_0.5 dirt …] [--seeds 0 1 2] [--quick] [--json FILE]
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Self

import msgspec
import yaml
from rich.console import Console

from benchmarks.live_system import running
from benchmarks.tables import Columns, table
from benchmarks.walking_actions import (
    ROBOT,
    Action,
    InTurn,
    Plan,
    Pushes,
    Stand,
    Velocity,
    all_around,
    along_axes,
    climb,
    straight_on,
)
from valor.analysis.walk import Figures
from valor.bags.errors import BagError
from valor.common import whole_file
from valor.common.document import Document
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.valorctl.walking import Order

QUICK_ROWS = ("flat_0.5", "dirt", "about", "rubble")


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
    content: Any = Document.load(ROBOT / "robot.yaml").content
    for name, values in tables.items():
        content[name] = {**content.get(name, {}), **values}
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return robot


COLUMNS: Columns[Run] = (
    ("row", lambda run: run.row),
    ("seed", lambda run: str(run.seed)),
    ("result", lambda run: run.failure or "ok"),
    ("true x, y [m]", lambda run: f"{run.way[0]:.2f}, {run.way[1]:.2f}"),
    ("turned", lambda run: f"{run.way[2]:.2f}"),
    ("time [s]", lambda run: f"{run.figures.duration:.1f}"),
    ("speed", lambda run: f"{run.figures.speed:.2f}"),
    ("DCM rms x, y, z [mm]", lambda run: ", ".join(f"{1e3 * each:.0f}" for each in run.figures.dcm_error)),
    ("knee", lambda run: f"{run.figures.knee:.2f}"),
    ("clamped", lambda run: str(run.figures.saturations)),
    ("Fz rms / median [N]", lambda run: f"{run.figures.force_error:.0f} / {run.figures.force_error_median:.1f}"),
    ("QP failures", lambda run: str(run.figures.qp_failures)),
    ("tick / p99 [ms]", lambda run: f"{1e3 * run.figures.tick_median:.2f} / {1e3 * run.figures.tick_99:.2f}"),
    ("missed", lambda run: f"{run.timeliness['overruns']:.0f}"),
    ("timed out", lambda run: f"{run.timeliness['waits_timed_out']:.0f}"),
    ("slip [s]", lambda run: f"{run.timeliness['slip']:.2f}"),
    ("RTF", lambda run: f"{run.timeliness['real_time_factor']:.2f}"),
    ("load", lambda run: f"{run.load:.1f}"),
)


def show(runs: list[Run], console: Console) -> None:
    """One table, a line a run."""
    console.print(table(f"Walking at 500 Hz, {os.cpu_count()} cores", COLUMNS, runs, left=["row", "result"]))


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
    whole_file.write(path, msgspec.json.format(msgspec.json.encode(runs), indent=1) + b"\n")


if __name__ == "__main__":
    main()
