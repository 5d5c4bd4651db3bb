"""Whether two cores carry the profile `hardware`: real-time factor, CPU of each process, and how late commands come.

Starts the system with everything the profile names, and measures it standing and walking. CPU is told per second of
robot time, so that a busy machine, which slows the robot down, can still be compared with a quiet one. The observer
listens to what is said a few times a second and no more; `valorctl walk` is the user that it takes to walk.

    .venv/bin/python benchmarks/hardware.py [--seconds 20] [--profile hardware] [--push 20] [--vx 0.3]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
from live_system import VALORCTL
from rich.console import Console
from rich.table import Table

import bifrost
from valor_common.errors import ValorError
from valor_common.instance import Instance
from valor_common.messages import ClockStatus, MotionState, PushReply, PushRequest, Statistics
from valor_common.processes import BY_NAME
from valor_common.topics import CLOCK, MOTION_STATE, PUSH, STATISTICS
from valorctl.leftovers import processes_of

SETTLING = 6.0  # after `up` [s]
PATIENCE = 10.0  # with the system [s]


@dataclass(frozen=True)
class Reading:
    """One look at the system."""

    wall: float  # [s]
    robot: float  # [s]
    cpu: dict[str, float]  # by process, since its start [s]

    def since(self, before: Reading) -> tuple[float, float, dict[str, float]]:
        """Real-time factor, share of both cores' time that anybody used, and CPU per robot second by process [%]."""
        passed, robot = self.wall - before.wall, self.robot - before.robot
        cpu = {name: 100.0 * (spent - before.cpu.get(name, 0.0)) / robot for name, spent in self.cpu.items()}
        return robot / passed, passed, cpu


class Watch:
    """Reads clock and processes of a running instance."""

    def __init__(self, instance: Instance, node: bifrost.Node) -> None:
        self._clock = node.subscriber(CLOCK.name, ClockStatus)
        self._states = node.subscriber(MOTION_STATE.name, MotionState)
        self._emulators = node.subscriber(STATISTICS["device_emulators"].name, Statistics)
        self._push = node.client(PUSH.name, PushRequest, PushReply)
        self._processes = {_name(each): each for each in processes_of(instance)}

    def read(self) -> Reading:
        """Look now."""
        if (received := self._clock.receive(PATIENCE)) is None:
            raise ValorError("nobody tells the time")
        cpu = {name: sum(process.cpu_times()[:2]) for name, process in self._processes.items()}
        return Reading(time.monotonic(), 1e-9 * received.message.time, cpu)

    def behavior(self) -> str:
        """Of the Motion System."""
        received = self._states.receive(PATIENCE)
        return received.message.behavior if received else "silent"

    def commands(self) -> str:
        """What the emulated plant says of the commands that it got."""
        received = self._emulators.latest() or self._emulators.receive(PATIENCE)
        return received.message.detail if received else "?"

    def push(self, impulse: float) -> None:
        """Sideways, for 0.1 s [N·s]."""
        reply = self._push.call(PushRequest(impulse_in_world=np.array((0.0, impulse, 0.0)), duration=0.1), PATIENCE)
        if not reply.accepted:
            raise ValorError(f"push refused: {reply.reason}")


def _name(process: psutil.Process) -> str:
    """A row of the table of processes; all others are `valorctl`'s."""
    line = process.cmdline()
    return next((name for name, row in BY_NAME.items() if row.module in line), "supervisor")


@contextmanager
def running(home: Path, options: argparse.Namespace) -> Iterator[tuple[Instance, Callable[..., str]]]:
    """The system, and `valorctl` for it."""
    environment = os.environ | {"VALOR_HOME": str(home), "VALOR_INSTANCE": "hardware"}

    def valorctl(*arguments: str) -> str:
        command = [str(VALORCTL), *arguments]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise ValorError(f"valorctl {' '.join(arguments)}: {(done.stderr or done.stdout).strip()}")
        return done.stdout.strip()

    valorctl("up", "--profile", options.profile, "--seed", str(options.seed))
    try:
        yield Instance("hardware", home), valorctl
    finally:
        valorctl("down")


def measure(options: argparse.Namespace, home: Path) -> list[tuple[str, float, dict[str, float], str]]:
    """Stand, walk, be pushed; a column each: what, real-time factor, CPU by process, word on the commands."""
    columns = []
    with (
        running(home, options) as (instance, valorctl),
        bifrost.Node("benchmark", network=bifrost.Network.load(instance.network_file, instance.keys)) as node,
    ):
        watch = Watch(instance, node)
        time.sleep(SETTLING)

        def phase(name: str, action: Callable[[], str]) -> None:
            before = watch.read()
            try:
                said = action()
            except ValorError as error:  # what was measured until then is worth telling
                said = str(error)
            factor, _, cpu = watch.read().since(before)
            columns.append((name, factor, cpu, watch.commands()))
            print(f"{name}: {factor:.3f} × real time; {watch.behavior()}; {said}; {columns[-1][3]}", flush=True)

        def wait(seconds: float) -> str:
            time.sleep(seconds)
            return ""

        phase("standing", lambda: wait(options.seconds))
        if options.vx:
            phase("walking", lambda: valorctl("walk", "--vx", str(options.vx), "--for", str(options.seconds)))
        if options.push:
            for k in range(options.pushes):
                watch.push((-1) ** k * options.push)
                time.sleep(4.0)
            print(f"after {options.pushes} pushes of {options.push:g} N·s sideways: {watch.behavior()}", flush=True)
    return columns


def show(columns: list[tuple[str, float, dict[str, float], str]]) -> None:
    """The table."""
    table = Table(title="CPU per second of robot time [% of a core]")
    table.add_column("process")
    for name, factor, _, _ in columns:
        table.add_column(f"{name}, {factor:.3f} × real time", justify="right")
    first = columns[0][2]
    for process in sorted(first, key=lambda each: -first[each]):
        table.add_row(process, *(f"{cpu.get(process, 0.0):.1f}" for _, _, cpu, _ in columns))
    table.add_row("all", *(f"{sum(cpu.values()):.1f}" for _, _, cpu, _ in columns), style="bold")
    Console(width=None if sys.stdout.isatty() else 160).print(table)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--profile", default="hardware")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=20.0, help="standing [s of the wall], walking [robot time, s]")
    parser.add_argument("--vx", type=float, default=0.3, help="of the walk [m/s]; 0: none")
    parser.add_argument("--push", type=float, default=20.0, help="sideways, standing [N·s]; 0: none")
    parser.add_argument("--pushes", type=int, default=2)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="valor-") as home:
        try:
            show(measure(options, Path(home)))
        except ValorError as error:
            sys.exit(str(error))


if __name__ == "__main__":
    main()
