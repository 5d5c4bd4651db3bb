"""What the operator's page costs the robot, and how old what it shows is.

One live system, a robot that walks; in turns, a round after the other: without `operator_station`, with it and nobody
who looks, with one viewer. The viewer is a process that speaks the page's protocol and draws nothing
(`benchmarks/page_viewer.py`), as a browser elsewhere would be; the station's CPU is counted by its pid.

The age of what is shown is, at each moment, that of the measurement from which the newest pelvis came that the viewer
has: from Proprioceptor's publication on, without the drawing.

    .venv/bin/python benchmarks/operator_page.py [--rounds 3] [--seconds 15] [--robot escher] [--still]
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np
import psutil
from rich.console import Console

import bifrost
from benchmarks.live_system import VALORCTL, started, valorctl
from benchmarks.page_viewer import Watched, ready, watch
from benchmarks.tables import Columns, table
from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.topics import MOTION_STATE, PROPRIOCEPTOR, STATISTICS
from valor.common.viewing import page_port
from valor.robot.description import RobotDescription
from valor.robot.model import full_model

STATION = "operator_station"
PATIENCE = 60.0  # with its start [s]
SETTLING = 3.0  # behind each change [s]
SPEED = (0.15, 0.1)  # of the robot: forward [m/s], turning [rad/s]
TURNS = ("without", "nobody looks", "one viewer")
SAMPLES = 1e-3  # of the age [s]

States: TypeAlias = list[tuple[float, FloatArray]]


@dataclass
class Turn:
    """What one kind of turn has seen, over all rounds.

    Attributes:
        ticks: of the Motion Manager [s].
        robot: robot time [s].
        wall: time [s].
        cpu: of the station [s].
        watched: by the viewer.
        ages: of what was shown [s].
    """

    ticks: list[float] = field(default_factory=list)
    robot: float = 0.0
    wall: float = 0.0
    cpu: float = 0.0
    watched: list[Watched] = field(default_factory=list)
    ages: list[FloatArray] = field(default_factory=list)


class Bench:
    """One live system, and who listens to it."""

    def __init__(self, instance: Instance, node: bifrost.Node, seconds: float) -> None:
        self._instance, self._seconds = instance, seconds
        self._states = MOTION_STATE.subscriber(node, queue=100000)
        self._senses = PROPRIOCEPTOR.subscriber(node, queue=100000)
        self._station = STATISTICS[STATION].subscriber(node)
        self._port = page_port(instance.settings())
        model = full_model(RobotDescription.load(instance.settings().robot), "all").mj
        self._root = f"/robot/{model.body(1).name}"
        self._viewers = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
        self._viewers.submit(ready).result()

    @contextmanager
    def station(self) -> Iterator[int]:
        """It runs; its pid.

        Raises:
            ValorError: it does not start.
        """
        environment = os.environ | {
            "VALOR_HOME": str(self._instance.folder.parent), "VALOR_INSTANCE": self._instance.name
        }  # fmt: skip
        command = [str(VALORCTL), "view"]
        with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as view:
            try:
                yield self._ready()
            finally:
                view.terminate()

    def _ready(self) -> int:
        """The station's pid, when it serves."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            received = self._station.receive(timeout=1.0)
            if received and received.message.state == "ready" and psutil.pid_exists(received.message.pid):
                return received.message.pid
        raise ValorError(f"{STATION} is not ready within {PATIENCE:g} s")

    def measure(self, name: str, turn: Turn, pid: int | None) -> None:
        """Take one turn; ``pid``: of the station."""
        viewer = None
        if name == TURNS[2]:
            viewer = self._viewers.submit(watch, self._port, self._root, SETTLING, self._seconds)
        *_, settling, _ = self._pass(SETTLING)
        process = psutil.Process(pid) if pid is not None else None
        used, began = _used(process), time.monotonic()
        first, last, states, ticks = self._pass(self._seconds)
        turn.wall += time.monotonic() - began
        turn.cpu += _used(process) - used
        turn.robot += last - first
        turn.ticks += ticks
        if viewer is not None:
            watched = viewer.result(timeout=PATIENCE)
            turn.watched.append(watched)
            turn.ages.append(ages(settling + states, watched.shown))

    def _pass(self, seconds: float) -> tuple[float, float, States, list[float]]:
        """Robot time at the begin and the end [s]; when the measurement of each state came, and its pelvis; ticks."""
        self._states.drain()
        self._senses.drain()
        published: dict[int, float] = {}
        states: States = []
        ticks: list[float] = []
        times: list[int] = []
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            time.sleep(0.05)
            for sensed in self._senses.drain():
                published[sensed.message.sequence] = 1e-9 * sensed.stamp
            for received in self._states.drain():
                state = received.message
                ticks.append(state.tick_time)
                times.append(state.time)
                if (stamp := published.get(state.proprioceptor_sequence)) is not None:
                    states.append((stamp, state.pelvis_position_in_odom))
        if not times:
            raise ValorError(f"{MOTION_STATE.name} is silent")
        return 1e-9 * times[0], 1e-9 * times[-1], states, ticks

    def close(self) -> None:
        """Dismiss the viewer."""
        self._viewers.shutdown()


def ages(states: States, shown: States) -> FloatArray:
    """(k,) of what a viewer has, at moments evenly apart [s].

    Args:
        states: when each state's measurement was published, monotonic [s], and its pelvis, (3,).
        shown: when each place came, and that place.
    """
    if not states or len(shown) < 2:
        return np.zeros(0)
    places = np.array([place for _, place in states])
    stamps = np.array([stamp for stamp, _ in states])
    came, made = [], []
    for when, place in shown:
        distance = np.abs(places - place).max(axis=1)
        if distance.min() < 1e-6:  # the same number, through ROS and the page; a period moves it by more
            came.append(when)
            made.append(stamps[int(distance.argmin())])
    if len(came) < 2:
        return np.zeros(0)
    moments = np.arange(came[0], came[-1], SAMPLES)
    newest = np.searchsorted(came, moments, side="right") - 1
    held: FloatArray = moments - np.array(made)[newest]
    return held


def _used(process: psutil.Process | None) -> float:
    """CPU time [s]."""
    if process is None:
        return 0.0
    times = process.cpu_times()
    return float(times.user + times.system)


def columns() -> Columns[tuple[str, Turn]]:
    """Of the table."""

    def of_ticks(share: float) -> str:
        return f"tick p{share:g} [ms]"

    def viewed(turn: Turn) -> float:
        return sum(each.seconds for each in turn.watched)

    def rate(turn: Turn, count: float, digits: int = 1) -> str:
        return f"{count / viewed(turn):.{digits}f}" if turn.watched else "–"

    def age(turn: Turn, share: float) -> str:
        known = np.concatenate(turn.ages) if turn.ages else np.zeros(0)
        return f"{1e3 * float(np.percentile(known, share)):.0f}" if len(known) else "–"

    return (
        ("operator_station", lambda row: row[0]),
        *((of_ticks(share), lambda row, share=share: f"{1e3 * float(np.percentile(row[1].ticks, share)):.3f}")
          for share in (50, 99)),
        ("real-time factor", lambda row: f"{row[1].robot / row[1].wall:.3f}"),
        ("CPU [% of a core]", lambda row: f"{100.0 * row[1].cpu / row[1].wall:.1f}" if row[1].cpu else "–"),
        ("frames [1/s]", lambda row: rate(row[1], sum(len(each.shown) for each in row[1].watched))),
        ("[kB/s]", lambda row: rate(row[1], 1e-3 * sum(each.size for each in row[1].watched), 0)),
        ("age p50 [ms]", lambda row: age(row[1], 50)),
        ("age p99 [ms]", lambda row: age(row[1], 99)),
    )  # fmt: skip


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=15.0, help="of each turn")
    parser.add_argument("--robot", default="escher")
    parser.add_argument("--still", action="store_true", help="the robot stands")
    options = parser.parse_args()
    turns: dict[str, Turn] = defaultdict(Turn)
    with tempfile.TemporaryDirectory() as scratch, ExitStack() as stack:
        instance = Instance("page-benchmark", Path(scratch) / "home")
        try:
            node = stack.enter_context(started(instance, "--robot", options.robot, "--no-bag"))
            if not options.still:
                stack.enter_context(walking(instance))
            bench = Bench(instance, node, options.seconds)
            stack.callback(bench.close)
            for number in range(options.rounds):
                _round(bench, turns, reverse=bool(number % 2))
        except (ValorError, OSError) as error:
            sys.exit(str(error))
    load = psutil.getloadavg()[0] / (psutil.cpu_count() or 1)
    title = f"{options.robot}, {'stands' if options.still else 'walks'}; load {load:.1f} a core"
    Console(width=150).print(
        table(title, columns(), [(name, turns[name]) for name in TURNS], left=("operator_station",))
    )


def _round(bench: Bench, turns: dict[str, Turn], *, reverse: bool) -> None:
    """Each once: from nothing to a viewer, or back."""
    without, alone, viewed = TURNS
    if not reverse:
        bench.measure(without, turns[without], None)
    with bench.station() as pid:
        for name in (viewed, alone) if reverse else (alone, viewed):
            bench.measure(name, turns[name], pid)
    if reverse:
        bench.measure(without, turns[without], None)


@contextmanager
def walking(instance: Instance) -> Iterator[None]:
    """The robot walks in a circle."""
    valorctl(instance, "mode", "walk")
    environment = os.environ | {"VALOR_HOME": str(instance.folder.parent), "VALOR_INSTANCE": instance.name}
    command = [str(VALORCTL), "walk", "--vx", str(SPEED[0]), "--wz", str(SPEED[1]), "--for", "3600"]
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as walk:
        try:
            yield
        finally:
            walk.terminate()


if __name__ == "__main__":
    main()
