"""Walking, pushes and standing of ESCHER: real processes of the whole system, plant and model different.

Each run starts its own system (lockstep, as fast as possible: the machine's load slows the clock and not the robot),
does what its row in ``ROWS`` states, and records what the Motion Manager publishes. The simulator's truth is used only
for the true way.

    python -m benchmarks.walking [--rows flat_0.5 dirt …] [--seeds 0 1 2] [--quick]
"""

from __future__ import annotations

import argparse
import math
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console

import bifrost
from benchmarks.live_system import push, started
from benchmarks.tables import Columns, table
from benchmarks.walks import over_stairs
from harness.places import ROBOTS
from valor.analysis.walk.track import Track, WalkMetrics
from valor.bags.errors import BagError
from valor.common.behaviors import WALKING
from valor.common.document import Document
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import ClockStatus, GroundTruth, MotionState, Proprioceptor
from valor.common.topics import CLOCK, GROUND_TRUTH, MOTION_STATE, PROPRIOCEPTOR
from valor.robot.description import RobotDescription
from valor.robot.step_plan import PlanStep
from valor.simulation import worlds
from valor.simulation.worlds.courses import Stairs
from valor.valorctl.drive import stepping
from valor.valorctl.drive.walking import WalkRequest, walk

ROBOT = ROBOTS / "escher"
QUICK_ROWS = ("flat_0.5", "dirt", "about", "rubble")
QUICK_SECONDS, QUICK_DISTANCE, QUICK_PUSHES = 5.0, 2.0, 2
STANDING = (-0.012, 0.1)  # x and |y| of the soles at the start [m]
STEP = 0.25  # step length on a floor taken for flat [m]
SETTLING = 3.0  # from the servos' posture to the controller's [robot time, s]
SILENCE = 10.0  # timeout of the Motion Manager [s]
SPREAD = 2.618 * 1.326  # two steps at 0.3 m/s take 1.326 s: pushes so far apart come at all phases [robot time, s]
AXES = (0.0, math.pi, math.pi / 2, -math.pi / 2)  # forward, back, left, right
AROUND = tuple(math.remainder(3 * k * math.pi / 4, 2.0 * math.pi) for k in range(8))


PIECE = 2000  # states stored as messages
LATE = 200  # of these, states that may precede their measurement


class TrackBuilder:
    """Builds a track while the robot walks: as numbers, since the messages of a long walk exceed the memory."""

    def __init__(self, robot: RobotDescription) -> None:
        self._robot = robot
        self._states: list[MotionState] = []
        self._measured: list[Proprioceptor] = []
        self._pieces: list[Track] = []

    def add(self, states: Iterable[MotionState], measured: Iterable[Proprioceptor]) -> None:
        """Add messages, in order of time."""
        self._states += states
        self._measured += measured
        if len(self._states) > PIECE:
            self._keep(LATE)

    def track(self) -> Track | None:
        """Everything added; None if no state has its measurement."""
        self._keep(0)
        pieces = [piece for piece in self._pieces if piece.time.size]
        return Track.joined(pieces) if pieces else None

    def _keep(self, late: int) -> None:
        split = len(self._states) - late
        if split > 0:
            self._pieces.append(Track.from_messages(self._states[:split], self._measured, self._robot))
            last = self._states[split - 1].proprioceptor_sequence
            self._measured = [each for each in self._measured if each.sequence > last]
            del self._states[:split]


class Observer:
    """Client of a live system that keeps what one run publishes.

    Attributes:
        state: latest MotionState.
    """

    state: MotionState

    def __init__(self, instance: Instance, node: bifrost.Node) -> None:
        self.instance, self.node = instance, node
        self._states = MOTION_STATE.subscriber(node, queue=20000)
        self._measured = PROPRIOCEPTOR.subscriber(node, queue=20000)
        self._truths = GROUND_TRUTH.subscriber(node, queue=20000)
        self._clock = CLOCK.subscriber(node, queue=1000)
        self._track = TrackBuilder(RobotDescription.load(instance.settings().robot))
        self._truth: list[GroundTruth] = []  # first and last
        self._clocks: list[ClockStatus] = []
        self._heard = time.monotonic()
        while not hasattr(self, "state"):
            self.take()
            time.sleep(0.01)

    def take(self) -> None:
        """Take what has arrived.

        Raises:
            ValorError: no MotionState for ``SILENCE``.
        """
        came = [received.message for received in self._states.drain()]
        self._track.add(came, [received.message for received in self._measured.drain()])
        self._clocks += [received.message for received in self._clock.drain()]
        for received in self._truths.drain():
            self._truth[1:] = [received.message]
        if came:
            self._heard, self.state = time.monotonic(), came[-1]
        elif time.monotonic() - self._heard > SILENCE:
            raise ValorError(f"no {MOTION_STATE.name} for {SILENCE:g} s")

    def falls_within(self, seconds: float) -> bool:
        """Wait for a fall, at most so long [robot time, s]."""
        until = self.state.time + round(seconds * 1e9)
        while self.state.behavior != "fall":
            if self.state.time > until:
                return False
            time.sleep(0.01)
            self.take()
        return True

    def figures(self) -> WalkMetrics:
        """Metrics of the walk; of the whole run if the robot only stands."""
        track = self._track.track()
        if track is None:
            raise ValorError(f"no {MOTION_STATE.name} with its {PROPRIOCEPTOR.name} was received")
        try:
            first, last = track.walk()
        except BagError:
            first, last = float(track.time[0]), float(track.time[-1])
        return WalkMetrics.of(track.between(first, last))

    def way(self) -> tuple[float, float]:
        """True way of the pelvis: forward, left [m]."""
        x, y = (self._truth[-1].pelvis_position_in_world - self._truth[0].pelvis_position_in_world)[:2].tolist()
        return x, y

    def slip(self) -> float:
        """Robot time lost against the clock [s]."""
        return self._clocks[-1].slip - self._clocks[0].slip


Action = Callable[[Observer, int, bool], str]
"""Called with the seed and whether to be quick; returns what went wrong, or an empty string."""


def velocities(*requests: WalkRequest) -> Action:
    """Walk by velocity, one request after the other."""

    def act(observer: Observer, _seed: int, quick: bool) -> str:
        for each in requests[:2] if quick else requests:
            request = each
            if quick:
                shorter = {"distance": QUICK_DISTANCE} if each.distance else {"seconds": QUICK_SECONDS}
                request = replace(each, **shorter)  # type: ignore[arg-type]
            result = walk(observer.instance, request, observer.take)
            if result.reason or (request.distance and result.distance < 0.98 * request.distance):
                return result.reason or f"walked {result.distance:.1f} m of {request.distance:.1f} m"
        return ""

    return act


def plan(steps: list[PlanStep]) -> Action:
    """Take the steps of a plan in odom."""

    def act(observer: Observer, _seed: int, quick: bool) -> str:
        shown = steps[: round(QUICK_DISTANCE / STEP)] if quick else steps
        outcome = stepping.step_plan(observer.instance, shown, stepping.ODOM, observer.take)
        return f"fall: {observer.state.reason}" if observer.falls_within(1.0) else outcome.reason

    return act


def pushes(impulses: list[tuple[float, float]], count: int = 8, forward: float = 0.0, every: float = 4.0) -> Action:
    """Push the robot again and again.

    Args:
        impulses: one after the other: impulse [N·s], direction from x anticlockwise [rad].
        count: of pushes.
        forward: velocity [m/s]; 0: the robot stands.
        every: period [robot time, s].
    """

    def send(observer: Observer, k: int) -> None:
        impulse, direction = impulses[k % len(impulses)]
        push(observer.node, (impulse * math.cos(direction), impulse * math.sin(direction), 0.0))

    def act(observer: Observer, seed: int, quick: bool) -> str:
        most = QUICK_PUSHES if quick else count
        if not forward:
            for k in range(most):
                send(observer, k)
                if observer.falls_within(every):
                    return f"fall: {observer.state.reason} (push {k + 1})"
            return ""
        pushed, start = 0, observer.state.time
        first = 5.0 + seed * every / 7.0  # at full speed; each seed has its own phases

        def check() -> None:
            nonlocal pushed
            observer.take()
            due = 1e-9 * (observer.state.time - start) > first + pushed * every
            if due and pushed < most and observer.state.behavior in WALKING:
                send(observer, pushed + 3 * seed)
                pushed += 1

        request = WalkRequest(forward, seconds=first + 1.0 + most * every, straight=True)
        result = walk(observer.instance, request, check)
        return f"{result.reason} (push {pushed})" if result.reason else ""

    return act


def stand(observer: Observer, _seed: int, quick: bool) -> str:
    """Stand still for a minute."""
    return f"fall: {observer.state.reason}" if observer.falls_within(QUICK_SECONDS if quick else 60.0) else ""


def climb(name: str) -> Action:
    """Steps over a world of stairs."""
    stairs = worlds.WORLDS[name]
    assert isinstance(stairs, Stairs)
    return plan(over_stairs(RobotDescription.load(ROBOT).tables, stairs))


def straight_on(distance: float) -> Action:
    """Steps of one length on a floor taken for flat."""
    places = [STANDING[0] + min(distance, (i + 1) * STEP) for i in range(math.ceil(distance / STEP))]
    y, feet = STANDING[1], ("left", "right")
    made = enumerate([*places, places[-1]])
    return plan([PlanStep(foot=feet[i % 2], x=x, y=(-y if i % 2 else y), z=0.0) for i, x in made])  # type: ignore[arg-type]


def _by(forward: float = 0.0, left: float = 0.0, turn: float = 0.0, seconds: float = 30.0) -> WalkRequest:
    return WalkRequest(forward, left, turn, seconds)


@dataclass(frozen=True)
class Row:
    """World, number of seeds, action, and tables of robot.yaml that differ from the robot's."""

    world: str
    seeds: int
    action: Action
    note: str
    tables: dict[str, dict[str, object]] | None = None


BOUND = list(zip((25.6, 25.6, 35.7, 35.7), AXES, strict=True))  # 80 % of m·ω·Δξ, by `control.py fixed` [N·s]
FORCES = {impulse: [(impulse, at) for at in AROUND] for impulse in (15.0, 25.0)}
STEPPED = list(zip((40.0, 40.0, 35.0, 35.0), AXES, strict=True))
FIXED: dict[str, dict[str, object]] = {"disturbance": {"step_when_standing": False}}
# fmt: off
ROWS: dict[str, Row] = {
    "flat_0.5":        Row("flat", 5, velocities(_by(0.5)), "0.5 m/s for 30 s"),
    "flat_0.8":        Row("flat", 5, velocities(_by(0.8)), "0.8 m/s for 30 s"),
    "dirt":            Row("dirt", 3, velocities(WalkRequest(0.45, distance=61.0, straight=True)), "61 m at 0.45 m/s"),
    "about":           Row("flat", 3, velocities(_by(turn=0.4, seconds=8.0), _by(left=0.125, seconds=8.0),
                           _by(-0.25, seconds=8.0), _by(0.3, 0.08, 0.2, seconds=8.0)), "turn, aside, back, blended"),
    "stairs":          Row("stairs", 3, climb("stairs"), "3 × 10 cm up and down"),
    "stairs_15cm":     Row("stairs_15cm", 5, climb("stairs_15cm"), "3 × 15 cm up and down"),
    "rubble":          Row("rubble", 5, straight_on(3.5), "3.5 m, planned flat"),
    "push_fixed":      Row("flat", 3, pushes(BOUND), "80 % of m·ω·Δξ", FIXED),
    "push_stepping":   Row("flat", 3, pushes(STEPPED), "40, 40, 35 N·s, twice"),
    "push_walking":    Row("flat", 3, pushes(FORCES[15.0], 16, 0.3, SPREAD), "16 of 15 N·s at 0.3 m/s"),
    "push_walking_25": Row("flat", 3, pushes(FORCES[25.0], 16, 0.3, SPREAD), "16 of 25 N·s at 0.3 m/s"),
    "stand":           Row("flat", 3, stand, "60 s"),
}
# fmt: on


@dataclass(frozen=True)
class Run:
    """Result of one run."""

    row: str
    seed: int
    failure: str
    way: tuple[float, float]
    figures: WalkMetrics
    slip: float
    load: float


def measure(home: Path, name: str, seed: int, options: argparse.Namespace) -> Run:
    """Start a system, act as the row states, and stop it.

    Raises:
        ValorError: it does not start.
    """
    row, instance = ROWS[name], Instance(f"walking-{seed}", home)
    robot = robot_with(row.tables, home) if row.tables else ROBOT
    up = ("--world", row.world, "--seed", str(seed), "--actuators", options.actuators, "--robot", str(robot))
    with started(instance, *up, "--clock", options.clock, "--rtf", "0", "--no-bag") as node:
        observer = Observer(instance, node)
        observer.falls_within(SETTLING)
        try:
            failure = row.action(observer, seed, options.quick)
        except ValorError as error:
            failure = str(error)
        observer.take()
        return Run(name, seed, failure, observer.way(), observer.figures(), observer.slip(), os.getloadavg()[0])


def robot_with(tables: dict[str, dict[str, object]], folder: Path) -> Path:
    """Copy the robot with values of some tables replaced."""
    robot = folder / "robot"
    shutil.copytree(ROBOT, robot, dirs_exist_ok=True)
    content: Any = Document.load(ROBOT / "robot.yaml").content
    for name, values in tables.items():
        content[name] = {**content.get(name, {}), **values}
    (robot / "robot.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return robot


COLUMNS: Columns[Run] = (
    ("row", lambda run: run.row),
    ("seed", lambda run: str(run.seed)),
    ("result", lambda run: run.failure or "ok"),
    ("true x, y [m]", lambda run: f"{run.way[0]:.2f}, {run.way[1]:.2f}"),
    ("time [s]", lambda run: f"{run.figures.duration:.1f}"),
    ("speed", lambda run: f"{run.figures.speed:.2f}"),
    ("DCM rms x, y, z [mm]", lambda run: ", ".join(f"{1e3 * each:.0f}" for each in run.figures.dcm_error)),
    ("knee", lambda run: f"{run.figures.knee:.2f}"),
    ("clamped", lambda run: str(run.figures.saturations)),
    ("QP failures", lambda run: str(run.figures.qp_failures)),
    ("tick / p99 [ms]", lambda run: f"{1e3 * run.figures.tick_median:.2f} / {1e3 * run.figures.tick_99:.2f}"),
    ("slip [s]", lambda run: f"{run.slip:.2f}"),
    ("load", lambda run: f"{run.load:.1f}"),
)


def summary(runs: list[Run]) -> Iterator[str]:
    """Markdown of docs/whole_body_controller.md: the worst run of each row."""
    yield "| run | good | DCM error [mm] | least knee [rad] |\n|---|---|---|---|"
    for name, group in groupby(runs, lambda run: run.row):
        each = list(group)
        errors = ", ".join(f"{max(1e3 * run.figures.dcm_error[i] for run in each):.0f}" for i in range(3))
        good, knee = sum(not run.failure for run in each), min(run.figures.knee for run in each)
        yield f"| {name}: {ROWS[name].note} | {good}/{len(each)} | {errors} | {knee:.2f} |"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", nargs="+", choices=list(ROWS), metavar="ROW", help=", ".join(ROWS))
    parser.add_argument("--seeds", type=int, nargs="+", help="instead of each row's number of them")
    parser.add_argument("--quick", action="store_true", help="few rows, one seed, some seconds or metres each")
    parser.add_argument("--actuators", default="hardware", choices=("ideal", "hardware", "series_elastic"))
    parser.add_argument("--clock", default="lockstep", choices=("lockstep", "realtime"))
    options = parser.parse_args()
    runs: list[Run] = []
    for name in options.rows or (QUICK_ROWS if options.quick else ROWS):
        for seed in options.seeds or range(1 if options.quick else ROWS[name].seeds):
            began = time.monotonic()
            with tempfile.TemporaryDirectory(prefix="valor-") as home:
                try:
                    runs.append(measure(Path(home), name, seed, options))
                except ValorError as error:
                    sys.exit(f"{name}, seed {seed}: {error}")
            print(f"{name}, seed {seed}: {runs[-1].failure or 'ok'}; {time.monotonic() - began:.0f} s", flush=True)
    title = f"Walking at 500 Hz, {os.cpu_count()} cores"
    Console(width=200).print(table(title, COLUMNS, runs, left=["row", "result"]))
    print(*summary(runs), sep="\n")


if __name__ == "__main__":
    main()
