"""What standing costs: tick time, deadlines, real-time factors, CPU and memory of every process of a live system.

Starts the whole system with ``valorctl up`` for each clock and seed (profile ``hardware``: the plant is not the
controller's model), lets the robot stand, listens, and prints three tables. Robot time against the wall's is read from
the bag, where every Proprioceptor is, so that it costs the system nothing. The load of the machine stands beside the
numbers: on a shared machine medians can be trusted, the tails measure the neighbours.

    .venv/bin/python benchmarks/standing.py [--seconds 60] [--seeds 0 1 2] [--clocks lockstep realtime]
        [--profile hardware]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.live_system import started, valorctl
from benchmarks.tables import Columns, table
from benchmarks.time_ratio import TimeRatio
from valor.bags import recordings
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import GroundTruth, Statistics
from valor.common.topics import GROUND_TRUTH, MOTION_STATE, STATISTICS

SETTLING = 5.0  # from the servos' posture to the controller's, after `up` [s]


@dataclass
class Run:
    """What one run measured."""

    clock: str
    seed: int
    ticks: np.ndarray  # [s], from Proprioceptor at the socket to everything done
    motors: np.ndarray  # [s], the part of it until Motor is sent
    height: np.ndarray  # true pelvis height [m]
    drift: float  # true pelvis, horizontally, from first to last [m]
    overruns: dict[str, int]
    cycles: dict[str, int]
    status: dict[str, Any]
    load: float
    pace: TimeRatio
    cpu: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    memory: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))

    def misses(self) -> str:
        """How many of the Motion Manager's ticks took longer than a period."""
        misses, cycles = self.overruns["motion_manager"], self.cycles["motion_manager"]
        return f"{misses} of {cycles} ({100 * misses / max(1, cycles):.2f} %)"


def measure(home: Path, profile: str, clock: str, seed: int, seconds: float) -> Run:
    """Start, stand, listen, stop."""
    instance = Instance(f"standing-{clock}-{seed}", home)
    with started(
        instance, "--profile", profile, "--clock", clock, "--seed", str(seed), "--actuators", "hardware"
    ) as node:
        states = MOTION_STATE.subscriber(node, queue=2000)
        truths = GROUND_TRUTH.subscriber(node, queue=2000)
        statistics = {service: topic.subscriber(node) for service, topic in STATISTICS.items()}
        ticks: list[float] = []
        motors: list[float] = []
        truth: list[GroundTruth] = []
        first: dict[str, Statistics] = {}
        last: dict[str, Statistics] = {}
        cpu: dict[str, list[float]] = defaultdict(list)
        memory: dict[str, list[float]] = defaultdict(list)
        began = time.monotonic() + SETTLING
        recorded_from = time.time() + SETTLING
        while (now := time.monotonic()) < began + seconds:
            time.sleep(0.25)
            if now < began:
                states.drain()
                truths.drain()
                for subscriber in statistics.values():
                    subscriber.drain()
                continue
            heard = [received.message for received in states.drain()]
            ticks.extend(state.tick_time for state in heard)
            motors.extend(state.motor_time for state in heard)
            truth.extend(received.message for received in truths.drain())
            for service, subscriber in statistics.items():
                if received := subscriber.latest():
                    first.setdefault(service, received.message)
                    last[service] = received.message
                    cpu[service].append(received.message.cpu_percent)
                    memory[service].append(received.message.memory_mib)
        recorded_to = time.time()
        status = json.loads(valorctl(instance, "status", "--json"))
        for service in status["services"]:
            if service["name"] not in cpu:  # bifrostd answers for itself
                cpu[service["name"]].append(service["cpu_percent"])
                memory[service["name"]].append(service["memory_mib"])
    pelvis = np.array([sample.pelvis_position_in_world for sample in truth])
    return Run(
        clock=clock,
        seed=seed,
        ticks=np.array(ticks),
        motors=np.array(motors),
        height=pelvis[:, 2],
        drift=float(np.linalg.norm(pelvis[-1, :2] - pelvis[0, :2])),
        overruns={service: last[service].overruns - first[service].overruns for service in last},
        cycles={service: last[service].cycles - first[service].cycles for service in last},
        status=status,
        load=os.getloadavg()[0],
        pace=TimeRatio.of(recordings.look(instance.bags)[-1].folder, recorded_from, recorded_to),
        cpu=cpu,
        memory=memory,
    )


RUN: Columns[Run] = (("clock", lambda run: run.clock), ("seed", lambda run: str(run.seed)))
TICKS: Columns[Run] = (
    *RUN,
    ("tick median [ms]", lambda run: f"{np.median(run.ticks) * 1e3:.3f}"),
    ("p99", lambda run: f"{np.percentile(run.ticks, 99) * 1e3:.3f}"),
    ("max", lambda run: f"{run.ticks.max() * 1e3:.2f}"),
    ("to Motor [ms]", lambda run: f"{np.median(run.motors) * 1e3:.3f}"),
    ("p99", lambda run: f"{np.percentile(run.motors, 99) * 1e3:.3f}"),
    ("misses of 2 ms", lambda run: run.misses()),
    ("pelvis height ± [mm]", lambda run: f"{np.ptp(run.height) * 500:.2f}"),
    ("drift [mm]", lambda run: f"{run.drift * 1e3:.2f}"),
    ("behavior", lambda run: run.status["behavior"]),
    ("load", lambda run: f"{run.load:.1f}"),
)
PACE: Columns[Run] = (
    *RUN,
    ("real-time factor", lambda run: f"{run.pace.factor:.3f}"),
    ("of the worst second", lambda run: f"{run.pace.worst_second:.3f}"),
    ("of the last second", lambda run: f"{run.status['clock']['real_time_factor']:.3f}"),
    ("since start", lambda run: f"{run.status['clock']['real_time_factor_since_start']:.3f}"),
    ("slip since start [s]", lambda run: f"{run.status['clock']['slip_s']:.2f}"),
    ("period median [ms]", lambda run: f"{np.median(run.pace.periods) * 1e3:.3f}"),
    ("p99", lambda run: f"{np.percentile(run.pace.periods, 99) * 1e3:.3f}"),
    ("max", lambda run: f"{run.pace.periods.max() * 1e3:.1f}"),
    ("periods > 2.2 ms", lambda run: f"{100 * np.mean(run.pace.periods > 1.1 * run.pace.nominal):.2f} %"),
    ("> 4 ms: lost [s]", lambda run: f"{run.pace.lost_beyond(2.0 * run.pace.nominal):.2f}"),
)


def _processes(runs: list[Run]) -> Table:
    """CPU, memory and restarts of every process, over all runs."""

    def mean(samples: Iterable[list[float]]) -> float:
        return float(np.mean(np.concatenate(list(samples))))

    def restarts(name: str) -> int:
        return sum(entry["restarts"] for run in runs for entry in run.status["services"] if entry["name"] == name)

    columns: Columns[str] = (
        ("process", str),
        ("CPU [% of a core]", lambda name: f"{mean(run.cpu[name] for run in runs):.1f}"),
        ("memory [MiB]", lambda name: f"{mean(run.memory[name] for run in runs):.0f}"),
        ("restarts", lambda name: str(restarts(name))),
    )
    names = (entry["name"] for entry in runs[0].status["services"])
    return table("Processes, mean over the runs", columns, names, left=["process"])


def main() -> None:
    """Measure every case and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--profile", default="sim", help="hardware: with emulated devices; then --clocks realtime")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--clocks", nargs="+", default=["lockstep", "realtime"], choices=["lockstep", "realtime"])
    arguments = parser.parse_args()
    console = Console(width=150)
    runs: list[Run] = []
    with tempfile.TemporaryDirectory(prefix="valor-") as home:
        for clock in arguments.clocks:
            for seed in arguments.seeds:
                console.print(f"{clock}, seed {seed}: standing for {arguments.seconds:g} s …")
                try:
                    runs.append(measure(Path(home), arguments.profile, clock, seed, arguments.seconds))
                except ValorError as error:
                    sys.exit(str(error))

    title = f"Standing for {arguments.seconds:g} s at 500 Hz, {os.cpu_count()} cores"
    console.print(table(title, TICKS, runs))
    console.print(table("Robot time against the wall's", PACE, runs))
    console.print(_processes(runs))


if __name__ == "__main__":
    main()
