"""How well ESCHER walks: the whole system's real processes, plant and model different, an observer outside.

Each run starts a system of its own (``valorctl up``; lockstep, as fast as it goes unless --rtf says otherwise, so that
the machine's load slows the clock and not the robot), does what its row says and listens. Rows are the table ``ROWS``.

    .venv/bin/python benchmarks/walking.py [--rows flat_0.5 dirt …] [--seeds 0 1 2] [--quick] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Protocol, Self

from live_system import System, running
from rich.console import Console
from rich.table import Table

from valor_analysis.errors import BagError
from valor_analysis.walk import Figures
from valor_common import worlds
from valor_common.errors import ValorError
from valor_common.instance import Instance
from valor_common.worlds.stairs import Stairs
from valorctl import stepping
from valorctl.step_plan import PlanStep
from valorctl.walking import MODES, Order, walk

STANDING = (-0.012, 0.1)  # x and |y| of the soles at the start [m]
SOLE = (-0.10, 0.15)  # heel and toe from the sole's origin [m]
STEP = 0.25  # length on a floor taken for flat [m]
QUICK_SECONDS, QUICK_DISTANCE, QUICK_PUSHES = 5.0, 2.0, 2  # of a run with --quick
QUICK_ROWS = ("flat_0.5", "dirt", "turn", "rubble")


class Action(Protocol):
    """What a run does. It says what went wrong beside falling; nothing: it did what it was to do."""

    def __call__(self, system: System) -> str: ...

    @property
    def quick(self) -> Self:
        """The same, shorter."""


@dataclass(frozen=True)
class Velocity:
    """Walk by velocity, as ``valorctl walk`` does."""

    order: Order

    def __call__(self, system: System) -> str:
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
class Plan:
    """Take the steps of a plan in odom, as ``valorctl step`` does: over ROS and the Footstep Converter."""

    steps: Callable[[], list[PlanStep]]

    def __call__(self, system: System) -> str:
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

    impulse: float  # [N·s]
    forward: float = 0.0  # walking so meanwhile [m/s]; 0: standing
    every: float = 4.12  # [robot time, s]; no multiple of a step's, so that phases differ
    count: int = 8
    directions: tuple[float, ...] = (0.0, math.pi, math.pi / 2, -math.pi / 2)  # from x, anticlockwise [rad]

    def __call__(self, system: System) -> str:
        if self.forward:
            return self._walking(system)
        for k in range(self.count):
            system.push(self._impulse(k))
            if system.observer.wait(lambda state: state.behavior == "fall", self.every):
                return f"fall: {system.observer.state.reason} (push {k + 1})"
        return ""

    def _walking(self, system: System) -> str:
        pushed = 0
        start = system.observer.state.time

        def hear() -> None:
            nonlocal pushed
            system.observer.hear()
            state = system.observer.state
            due = 1e-9 * (state.time - start) > 5.0 + pushed * self.every
            if due and pushed < self.count and state.behavior in MODES:
                system.push(self._impulse(pushed))
                pushed += 1

        seconds = 6.0 + self.count * self.every
        result = walk(system.instance, Order(forward=self.forward, seconds=seconds, straight=True), hear)
        return f"{result.reason} (push {pushed})" if result.reason else ""

    def _impulse(self, k: int) -> tuple[float, float, float]:
        direction = self.directions[k % len(self.directions)]
        return self.impulse * math.cos(direction), self.impulse * math.sin(direction), 0.0

    @property
    def quick(self) -> Self:
        return replace(self, count=QUICK_PUSHES)


@dataclass(frozen=True)
class Stand:
    """Stand still."""

    seconds: float  # [robot time, s]

    def __call__(self, system: System) -> str:
        fell = system.observer.wait(lambda state: state.behavior == "fall", self.seconds)
        return f"fall: {system.observer.state.reason}" if fell else ""

    @property
    def quick(self) -> Self:
        return replace(self, seconds=QUICK_SECONDS)


def over_stairs(name: str) -> Callable[[], list[PlanStep]]:
    """Steps over a world of stairs, one foot a tread, and two more on the floor behind."""

    def steps() -> list[PlanStep]:
        stairs = worlds.WORLDS[name]
        assert isinstance(stairs, Stairs)
        heel, toe = SOLE
        margin = 0.5 * (stairs.tread - (toe - heel))
        places: list[tuple[float, float]] = [(stairs.start - toe - margin, 0.0)] * 2
        places += [(x + margin - heel, (i + 1) * stairs.rise) for i, x in enumerate(stairs.up)]
        top, edge = places[-1], stairs.down[0] - toe - margin
        between = max(1, math.ceil((edge - top[0]) / 0.3))
        places += [(top[0] + (edge - top[0]) * (i + 1) / between, top[1]) for i in range(between)]
        places.append(places[-1])
        heights = [(stairs.steps - 1 - i) * stairs.rise for i in range(stairs.steps)]
        places += [(x + margin - heel, height) for x, height in zip(stairs.down, heights, strict=True)]
        places += [(places[-1][0] + 0.2, 0.0)] * 2
        return _alternating(places)

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


def _by(forward: float = 0.0, left: float = 0.0, turn: float = 0.0, seconds: float = 30.0) -> Velocity:
    return Velocity(Order(forward, left, turn, seconds))


def _course(speed: float, distance: float = 61.0) -> Velocity:
    return Velocity(Order(speed, distance=distance, straight=True))


# fmt: off
ROWS: dict[str, Row] = {
    "flat_0.5":        Row("flat",        5, _by(0.5),                              "0.5 m/s for 30 s"),
    "flat_0.8":        Row("flat",        5, _by(0.8),                              "0.8 m/s for 30 s"),
    "flat_1.2":        Row("flat",        5, _by(1.2),                              "1.2 m/s for 30 s"),
    "dirt":            Row("dirt",        3, _course(0.4),                          "61 m at 0.4 m/s"),
    "dirt_0.5":        Row("dirt",        3, _course(0.5),                          "61 m at 0.5 m/s"),
    "turn":            Row("flat",        3, _by(turn=0.4, seconds=15.0),           "in place, 0.4 rad/s"),
    "sideways":        Row("flat",        3, _by(left=0.12, seconds=15.0),          "0.12 m/s to the left"),
    "backwards":       Row("flat",        3, _by(-0.25, seconds=15.0),              "0.25 m/s"),
    "blended":         Row("flat",        3, _by(0.3, 0.08, 0.2, seconds=15.0),     "0.3, 0.08 m/s, 0.2 rad/s"),
    "stairs":          Row("stairs",      3, Plan(over_stairs("stairs")),           "3 × 10 cm up and down"),
    "stairs_15cm":     Row("stairs_15cm", 5, Plan(over_stairs("stairs_15cm")),      "3 × 15 cm up and down"),
    "rubble":          Row("rubble",      5, Plan(straight_on(3.5)),                "3.5 m, planned flat"),
    "push_standing":   Row("flat",        3, Pushes(22.0),                          "22 N·s, four directions twice"),
    "push_stepping":   Row("flat",        3, Pushes(35.0),                          "35 N·s, four directions twice"),
    "push_walking":    Row("flat",        3, Pushes(15.0, forward=0.3),             "15 N·s at 0.3 m/s"),
    "push_walking_25": Row("flat",        3, Pushes(25.0, forward=0.3),             "25 N·s at 0.3 m/s"),
    "stand":           Row("flat",        3, Stand(60.0),                           "60 s"),
}
# fmt: on


@dataclass(frozen=True)
class Run:
    """What one run gave."""

    row: str
    seed: int
    actuators: str
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
    options = {
        "world": row.world, "seed": seed, "actuators": arguments.actuators, "clock": arguments.clock,
        "rtf": arguments.rtf, "bag": bags / "run.mcap",
    }  # fmt: skip
    try:
        with running(Instance(f"walking-{seed}", home), options, tell) as system:
            try:
                failure = (row.action.quick if arguments.quick else row.action)(system)
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
        name, seed, arguments.actuators, failure, observer.way(), Figures.of(track.between(first, last)),
        observer.timeliness(), observer.lost, os.getloadavg()[0],
    )  # fmt: skip


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
    parser.add_argument("--json", type=Path, help="where to keep every run")
    arguments = parser.parse_args()
    console = Console(width=None if sys.stdout.isatty() else 220)
    runs: list[Run] = []
    with tempfile.TemporaryDirectory(prefix="valor-") as home:
        for name, seed in cases(arguments):
            began = time.monotonic()
            try:
                with Teller(console, f"{name}, seed {seed}") as tell:
                    run = measure(Path(home), name, seed, arguments, tell)
            except ValorError as error:
                sys.exit(f"{name}, seed {seed}: {error}")
            runs.append(run)
            note = f"{name} ({ROWS[name].note}), seed {seed}"
            print(f"{note}: {run.failure or 'ok'}; {time.monotonic() - began:.0f} s", flush=True)
            if arguments.json:
                arguments.json.write_text(json.dumps([asdict(each) for each in runs], indent=1) + "\n")
    show(runs, console)


if __name__ == "__main__":
    main()
