"""How well ESCHER walks: the whole system's real processes, plant and model different, an observer outside.

Each run starts a system of its own (``valorctl up``, free-running unless --rtf says otherwise), does what its row says and
listens to MotionState, Proprioceptor, ClockStatus and Statistics. The simulator's truth is for the record alone: true
distance and lateral offset. Rows are the table ``ROWS`` below.

    .venv/bin/python benchmarks/walking.py [--rows flat_0.5 dirt …] [--seeds 0 1 2] [--actuators hardware] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import bifrost
from valor_analysis.bag import BagError
from valor_analysis.walk import Figures, Track
from valor_common import worlds
from valor_common.errors import ValorError
from valor_common.instance import Instance
from valor_common.messages import (
    ClockStatus,
    Footstep,
    FootstepPlanReply,
    FootstepPlanRequest,
    GroundTruth,
    MotionState,
    Proprioceptor,
    PushReply,
    PushRequest,
    Statistics,
    StepStatus,
)
from valor_common.robot import RobotDescription
from valor_common.topics import (
    CLOCK,
    FOOTSTEP_PLAN,
    GROUND_TRUTH,
    MOTION_MANAGER_STATISTICS,
    MOTION_STATE,
    PROPRIOCEPTOR,
    PUSH,
    STEP_STATUS,
)
from valor_common.worlds.stairs import Stairs
from valorctl import control_mode
from valorctl.walking import MODES, Order, walk

VALORCTL = Path(sys.executable).with_name("valorctl")
SILENCE = 10.0  # of the Motion Manager, after which a run is given up [s]
PLAN_TIMEOUT = 120.0  # [robot time, s]
STANDING_SOLE = (-0.012, 0.1)  # x and |y| of the soles at the start [m]
SOLE = (-0.10, 0.15)  # heel and toe from the sole's origin [m]


class Observer:
    """Hears what one run says.

    Attributes:
        states, measured, truths: all that came.
    """

    def __init__(self, node: bifrost.Node) -> None:
        self._states = node.subscriber(MOTION_STATE.name, MotionState, queue=20000)
        self._measured = node.subscriber(PROPRIOCEPTOR.name, Proprioceptor, queue=20000)
        self._truths = node.subscriber(GROUND_TRUTH.name, GroundTruth, queue=20000)
        self._clock = node.subscriber(CLOCK.name, ClockStatus, queue=1000)
        self._statistics = node.subscriber(MOTION_MANAGER_STATISTICS.name, Statistics, queue=1000)
        self.states: list[MotionState] = []
        self.measured: list[Proprioceptor] = []
        self.truths: list[GroundTruth] = []
        self._clocks: list[ClockStatus] = []
        self._fares: list[Statistics] = []
        self._heard = time.monotonic()

    def hear(self) -> None:
        """Take in what has come.

        Raises:
            ValorError: nothing comes any more.
        """
        came = [received.message for received in self._states.drain()]
        if came:
            self._heard = time.monotonic()
        elif time.monotonic() - self._heard > SILENCE:
            raise ValorError(f"{MOTION_STATE.name} is silent for {SILENCE:g} s")
        self.states += came
        self.measured += [received.message for received in self._measured.drain()]
        self.truths += [received.message for received in self._truths.drain()]
        self._clocks += [received.message for received in self._clock.drain()]
        self._fares += [received.message for received in self._statistics.drain()]

    @property
    def state(self) -> MotionState:
        """The newest; waits for the first."""
        while not self.states:
            self.hear()
            time.sleep(0.01)
        return self.states[-1]

    def wait(self, over: Callable[[MotionState], bool], longest: float) -> bool:
        """Listen until a state says so; whether one did within ``longest`` of robot time [s]."""
        until = self.state.time + round(longest * 1e9)
        while not over(self.state):
            if self.state.time > until:
                return False
            time.sleep(0.01)
            self.hear()
        return True

    def lost(self) -> int:
        """States that this observer missed."""
        return self._states.drops + self._measured.drops

    def timeliness(self) -> dict[str, float]:
        """Deadlines missed, waits timed out, slip."""
        overruns = self._fares[-1].overruns - self._fares[0].overruns if self._fares else 0
        first, last = (self._clocks[0], self._clocks[-1]) if self._clocks else (None, None)
        if first is None or last is None:
            return {"overruns": overruns}
        return {
            "overruns": overruns,
            "waits_timed_out": last.waits_timed_out - first.waits_timed_out,
            "slip": last.slip - first.slip,
        }

    def way(self) -> tuple[float, float, float]:
        """The true way of the pelvis: forward, left [m], turned [rad]."""
        first, last = self.truths[0], self.truths[-1]
        x, y = (last.pelvis_position_in_world - first.pelvis_position_in_world)[:2].tolist()
        turned = _heading(last.pelvis_orientation_in_world) - _heading(first.pelvis_orientation_in_world)
        return x, y, math.remainder(turned, 2.0 * math.pi)


def _heading(orientation: np.ndarray) -> float:
    w, x, y, z = orientation.tolist()
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@dataclass(frozen=True)
class System:
    """One running system, and who listens to it."""

    instance: Instance
    node: bifrost.Node
    observer: Observer
    seed: int

    def mode(self, name: str) -> None:
        """Go to a control mode."""
        change = control_mode.change(self.instance, name, check=self.observer.hear)
        if not change.reached:
            raise ValorError(change.describe())

    def push(self, impulse: tuple[float, float, float]) -> None:
        """Push the chest for 0.1 s [N·s]."""
        client = self.node.client(PUSH.name, PushRequest, PushReply)
        reply = client.call(PushRequest(impulse_in_world=np.array(impulse), duration=0.1), timeout=10.0)
        if not reply.accepted:
            raise ValorError(f"push refused: {reply.reason}")


# Each says whether the run did what it was to do, beside not falling; empty: it did.
Action = Callable[[System], str]


@dataclass(frozen=True)
class Velocity:
    """Walk by velocity."""

    order: Order

    def __call__(self, system: System) -> str:
        result = walk(system.instance, self.order, system.observer.hear)
        wanted = self.order.distance
        return result.reason or ("did not get there" if wanted and result.distance < 0.98 * wanted else "")


@dataclass(frozen=True)
class Plan:
    """Take the steps of a plan, over Bifrost."""

    steps: Callable[[], list[Footstep]]

    def __call__(self, system: System) -> str:
        steps = self.steps()
        progress = system.node.subscriber(STEP_STATUS.name, StepStatus, queue=1000)
        plans = system.node.client(FOOTSTEP_PLAN.name, FootstepPlanRequest, FootstepPlanReply)
        system.mode("step")
        reply = plans.call(FootstepPlanRequest(steps=steps), timeout=10.0)
        if not reply.accepted:
            return f"plan refused: {reply.reason}"
        words: list[StepStatus] = []

        def over(state: MotionState) -> bool:
            words.extend(received.message for received in progress.drain())
            ended = words and words[-1].state in ("finished", "failed")
            return bool(ended) or not state.behavior.startswith("step")

        system.observer.wait(over, PLAN_TIMEOUT)
        system.observer.wait(lambda state: state.behavior == "fall", 2.0)
        state = system.observer.state
        done = max((word.last_performed_step_index for word in words), default=-1)
        if state.behavior == "fall":
            return f"{state.reason}, after step {done} of {len(steps) - 1}"
        return "" if done == len(steps) - 1 else f"ended after step {done} of {len(steps) - 1}"


@dataclass(frozen=True)
class Pushes:
    """Push the robot again and again, standing or walking by velocity, one direction after the other."""

    impulse: float  # [N·s]
    forward: float = 0.0  # walking so meanwhile [m/s]; 0: standing
    every: float = 4.0  # [robot time, s]; no multiple of a step's, so that phases differ
    count: int = 8
    directions: tuple[float, ...] = (0.0, math.pi, math.pi / 2, -math.pi / 2)  # from x, anticlockwise [rad]

    def __call__(self, system: System) -> str:
        if self.forward:
            pushed = 0
            start = system.observer.state.time

            def hear() -> None:
                nonlocal pushed
                system.observer.hear()
                state = system.observer.state
                if pushed < self.count and state.behavior in MODES:
                    if 1e-9 * (state.time - start) > 5.0 + pushed * 1.03 * self.every:
                        system.push(self._impulse(pushed))
                        pushed += 1

            seconds = 6.0 + self.count * 1.03 * self.every
            result = walk(system.instance, Order(forward=self.forward, seconds=seconds, straight=True), hear)
            return f"{result.reason} (push {pushed})" if result.reason else ""
        for k in range(self.count):
            system.push(self._impulse(k))
            if system.observer.wait(lambda state: state.behavior == "fall", self.every):
                return f"{system.observer.state.reason} (push {k + 1})"
        return ""

    def _impulse(self, k: int) -> tuple[float, float, float]:
        direction = self.directions[k % len(self.directions)]
        return self.impulse * math.cos(direction), self.impulse * math.sin(direction), 0.0


@dataclass(frozen=True)
class Stand:
    """Stand still."""

    seconds: float  # [robot time, s]

    def __call__(self, system: System) -> str:
        return system.observer.state.reason if system.observer.wait(lambda s: s.behavior == "fall", self.seconds) else ""


def over_stairs(name: str) -> Callable[[], list[Footstep]]:
    """Steps over a world of stairs, one foot a tread, and two more on the floor behind."""

    def steps() -> list[Footstep]:
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


def straight_on(distance: float, length: float = 0.25) -> Callable[[], list[Footstep]]:
    """Steps of a length on a floor taken for flat."""

    def steps() -> list[Footstep]:
        count = math.ceil(distance / length)
        places = [(STANDING_SOLE[0] + min(distance, (i + 1) * length), 0.0) for i in range(count)]
        return _alternating([*places, places[-1]])

    return steps


def _alternating(places: list[tuple[float, float]]) -> list[Footstep]:
    """Left and right in turn at places (x, z)."""
    level = np.array([1.0, 0.0, 0.0, 0.0])
    y = STANDING_SOLE[1]
    return [
        Footstep(
            step_index=i, foot=i % 2, position_in_odom=np.array([x, y if i % 2 == 0 else -y, z]),
            orientation_in_odom=level, swing_height=0.0, swing_duration=0.0, transfer_duration=0.0,
        )
        for i, (x, z) in enumerate(places)
    ]  # fmt: skip


@dataclass(frozen=True)
class Row:
    """What is measured: a world, an action, how many seeds unless told otherwise."""

    world: str
    seeds: int
    action: Action
    note: str


def _by(forward: float = 0.0, left: float = 0.0, turn: float = 0.0, seconds: float = 30.0, **more: bool) -> Velocity:
    return Velocity(Order(forward, left, turn, seconds, **more))


# fmt: off
ROWS: dict[str, Row] = {
    "flat_0.5":        Row("flat", 5, _by(0.5),                                        "0.5 m/s for 30 s"),
    "flat_0.8":        Row("flat", 5, _by(0.8),                                        "0.8 m/s for 30 s"),
    "flat_1.2":        Row("flat", 5, _by(1.2),                                        "1.2 m/s for 30 s (ideal)"),
    "dirt":            Row("dirt", 3, Velocity(Order(0.4, distance=61.0, straight=True)), "61 m at 0.4 m/s"),
    "dirt_0.5":        Row("dirt", 3, Velocity(Order(0.5, distance=61.0, straight=True)), "61 m at 0.5 m/s"),
    "turn":            Row("flat", 3, _by(turn=0.4, seconds=15.0),                     "in place, 0.4 rad/s"),
    "sideways":        Row("flat", 3, _by(left=0.12, seconds=15.0),                    "0.12 m/s to the left"),
    "backwards":       Row("flat", 3, _by(-0.25, seconds=15.0),                        "0.25 m/s"),
    "blended":         Row("flat", 3, _by(0.3, 0.08, 0.2, seconds=15.0),               "0.3, 0.08 m/s, 0.2 rad/s"),
    "stairs":          Row("stairs", 3, Plan(over_stairs("stairs")),                   "3 × 10 cm up and down"),
    "stairs_15cm":     Row("stairs_15cm", 5, Plan(over_stairs("stairs_15cm")),         "3 × 15 cm up and down"),
    "rubble":          Row("rubble", 5, Plan(straight_on(3.5)),                        "3.5 m, planned flat"),
    "push_standing":   Row("flat", 3, Pushes(22.0),                                    "22 N·s, four directions twice"),
    "push_stepping":   Row("flat", 3, Pushes(35.0),                                    "35 N·s, four directions twice"),
    "push_walking":    Row("flat", 3, Pushes(15.0, forward=0.3),                       "15 N·s at 0.3 m/s"),
    "push_walking_25": Row("flat", 3, Pushes(25.0, forward=0.3),                       "25 N·s at 0.3 m/s"),
    "stand":           Row("flat", 3, Stand(60.0),                                     "60 s"),
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
    figures: Figures | None  # None: it never walked
    timeliness: dict[str, float]
    lost: int  # messages that the observer missed
    load: float  # of the machine


def measure(home: Path, name: str, seed: int, actuators: str, rtf: float) -> Run:
    """Start a system, do what the row says, and stop it."""
    row = ROWS[name]
    instance = Instance(f"walking-{seed}", home)
    environment = os.environ | {"VALOR_HOME": str(home), "VALOR_INSTANCE": instance.name}

    def valorctl(*arguments: str) -> None:
        done = subprocess.run(
            [str(VALORCTL), *arguments], env=environment, capture_output=True, text=True, check=False
        )
        if done.returncode:
            sys.exit(f"valorctl {' '.join(arguments)}: {done.stderr.strip()}")

    valorctl("up", "--world", row.world, "--seed", str(seed), "--actuators", actuators, "--rtf", f"{rtf:g}",
             "--bag", str(home / "last.mcap"))  # fmt: skip
    try:
        robot = RobotDescription.load(instance.settings().robot)
        network = bifrost.Network.load(instance.network_file, instance.keys)
        with bifrost.Node("benchmark", network=network) as node:
            observer = Observer(node)
            observer.wait(lambda _: False, 3.0)  # settles on the controller
            try:
                failure = row.action(System(instance, node, observer, seed))
            except ValorError as error:
                failure = str(error)
            observer.hear()
    finally:
        valorctl("down")
        for bag in home.glob("last*.mcap"):
            bag.unlink()
    track = Track.heard(observer.states, observer.measured, robot)
    try:
        first, last = track.walk()
    except BagError:
        first, last = float(track.time[0]), float(track.time[-1])
    return Run(
        name, seed, actuators, failure, observer.way(), Figures.of(track.between(first, last)),
        observer.timeliness(), observer.lost(), os.getloadavg()[0],
    )  # fmt: skip


def show(runs: list[Run], console: Console) -> None:
    """One table, a line a run."""
    table = Table(title=f"Walking at 500 Hz, {os.cpu_count()} cores")
    for heading in ("row", "seed", "result", "true x, y [m]", "turned", "time [s]", "speed", "DCM rms x, y, z [mm]",
                    "knee", "clamped", "Fz rms / median [N]", "QP failures", "tick / p99 [ms]", "missed", "slip",
                    "load"):  # fmt: skip
        table.add_column(heading, justify="left" if heading in ("row", "result") else "right")
    for run in runs:
        x, y, turned = run.way
        f = run.figures
        cells = ["–"] * 8
        if f is not None:
            cells = [
                f"{f.duration:.1f}",
                f"{f.speed:.2f}",
                ", ".join(f"{1e3 * each:.0f}" for each in f.dcm_error),
                f"{f.knee:.2f}",
                str(f.saturations),
                f"{f.force_error:.0f} / {f.force_error_median:.1f}",
                str(f.qp_failures),
                f"{1e3 * f.tick_median:.2f} / {1e3 * f.tick_99:.2f}",
            ]
        table.add_row(
            run.row, str(run.seed), run.failure or "ok", f"{x:.2f}, {y:.2f}", f"{turned:.2f}", *cells,
            f"{run.timeliness.get('overruns', 0):.0f}", f"{run.timeliness.get('slip', 0):.2f}", f"{run.load:.1f}",
        )  # fmt: skip
    console.print(table)


def cases(arguments: argparse.Namespace) -> Iterator[tuple[str, int]]:
    """Rows and seeds that are asked for."""
    for name in arguments.rows:
        yield from ((name, seed) for seed in arguments.seeds or range(ROWS[name].seeds))


def main() -> None:
    """Measure, print, keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", nargs="+", default=list(ROWS), choices=list(ROWS), metavar="ROW")
    parser.add_argument("--seeds", type=int, nargs="+", help="instead of each row's own number of them")
    parser.add_argument("--actuators", default="hardware")
    parser.add_argument("--rtf", type=float, default=0.0, help="real-time factor; 0: as fast as it goes")
    parser.add_argument("--json", type=Path, help="where to keep every run")
    arguments = parser.parse_args()
    console = Console(width=190)
    runs: list[Run] = []
    with tempfile.TemporaryDirectory(prefix="valor-") as home:
        for name, seed in cases(arguments):
            began = time.monotonic()
            runs.append(measure(Path(home), name, seed, arguments.actuators, arguments.rtf))
            console.print(
                f"{name} ({ROWS[name].note}), seed {seed}: {runs[-1].failure or 'ok'} "
                f"({time.monotonic() - began:.0f} s)", soft_wrap=True,
            )  # fmt: skip
            if arguments.json:
                arguments.json.write_text(json.dumps([asdict(run) for run in runs], indent=1) + "\n")
    show(runs, console)


if __name__ == "__main__":
    main()
