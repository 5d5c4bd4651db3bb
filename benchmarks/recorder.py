"""The recorder at full traffic: does it lose messages, how much of a core does it take, does its memory grow?

A live system in control mode ``manipulate``, in which every topic of the control loop flows at its full rate, recorded
whole for some minutes. A row a minute, then what became of each topic's messages, as the bag itself says.

    .venv/bin/python benchmarks/recorder.py [--minutes 10] [--robot escher] [--profile sim] [--keep FOLDER]

The exit status says whether a message was lost.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path

import psutil
from mcap.reader import make_reader

import bifrost
from benchmarks.live_system import started
from thesis.analysis.process_statistics import Sampler
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import Proprioceptor
from valor.common.topics import PROPRIOCEPTOR
from valor.valorctl.drive import control_mode
from valor.valorctl.instance.supervision import Supervisor

MODE = "manipulate"
SETTLING = 5.0  # [s]
PERIOD = 1.0  # between two looks [s]


def main() -> int:
    """Record, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--robot", default="escher")
    parser.add_argument("--profile", default="sim")
    parser.add_argument("--keep", type=Path, help="where the bag shall stay; it is removed unless given")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        bag = options.keep or Path(scratch) / "recorder"
        instance = Instance("recorder-benchmark", Path(scratch) / "home")
        up = ("--profile", options.profile, "--robot", options.robot, "--bag", str(bag.absolute()))
        try:
            with started(instance, *up) as node:
                _watch(instance, node, options.minutes, bag)
        except ValorError as error:
            sys.exit(str(error))
        return _tell(sorted(bag.glob("*.mcap")), options)


def _watch(instance: Instance, node: bifrost.Node, minutes: float, bag: Path) -> None:
    """Look at the recorder every second, and print a row a minute."""
    change = control_mode.change(instance, MODE)
    if not change.reached:
        sys.exit(change.describe())
    pid = Supervisor(instance).processes()["bag_recorder"].pid
    assert pid is not None
    senses = PROPRIOCEPTOR.subscriber(node)
    time.sleep(SETTLING)
    sampler = Sampler({"bag_recorder": pid})
    _print_row("after [min]", "of a core [%]", "most in a second [%]", "memory [MiB]", "bag [MB/s]",
               "robot time", "load")  # fmt: skip
    _print_row(*["--:"] * 7)
    rows, size, began = 0, _size(bag), time.monotonic()
    first = _robot_time(senses)
    while (elapsed := time.monotonic() - began) < 60.0 * minutes:
        time.sleep(PERIOD)
        sampler.sample()
        usage = sampler.usage()["bag_recorder"]
        if int(elapsed / 60.0) > rows or elapsed + PERIOD >= 60.0 * minutes:
            cpu = usage.cpu[60 * rows :]
            pace = (_robot_time(senses) - first) / (time.monotonic() - began)
            rate = (_size(bag) - size) / 1e6 / (time.monotonic() - began)
            _print_row(f"{elapsed / 60.0:.1f}", f"{cpu.mean():.1f}", f"{cpu.max():.1f}", f"{usage.memory[-1]:.1f}",
                       f"{rate:.2f}", f"{pace:.3f}", f"{psutil.getloadavg()[0]:.1f}")  # fmt: skip
            rows = int(elapsed / 60.0)
    usage = sampler.usage()["bag_recorder"]
    grown = usage.memory[-1] - usage.memory[min(len(usage.memory) - 1, 30)]
    print(f"\n{usage.cpu.mean():.1f} % of a core; memory grew by {grown:+.1f} MiB after the first half minute")


def _tell(files: list[Path], options: argparse.Namespace) -> int:
    """What became of each topic's messages; returns whether one was lost."""
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for file in files:
        with open(file, "rb") as opened:
            records = {each.name: each.metadata for each in make_reader(opened).iter_metadata()}
        for topic, count in records["topics"].items():
            counts[topic].update(json.loads(count))
    size = sum(file.stat().st_size for file in files)
    print(f"\n{options.robot}, {options.profile}: {size / 1e6:.0f} MB in {len(files)} files\n")
    _print_row("topic", "received", "written", "dropped")
    _print_row("---", "--:", "--:", "--:")
    for topic, count in counts.items():
        if any(count.values()):
            _print_row(topic, *(str(count[what]) for what in ("received", "written", "dropped")))
    whole = {what: sum(count[what] for count in counts.values()) for what in ("received", "written", "dropped")}
    _print_row("all", *(str(value) for value in whole.values()))
    return int(whole["dropped"] > 0)


def _size(bag: Path) -> int:
    return sum(file.stat().st_size for file in bag.glob("*.mcap"))


def _robot_time(senses: bifrost.Subscriber[Proprioceptor]) -> float:
    senses.latest()
    received = senses.receive(timeout=10.0)
    if received is None:
        sys.exit(f"no {PROPRIOCEPTOR.name}")
    return 1e-9 * received.message.time


def _print_row(*cells: str) -> None:
    print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
