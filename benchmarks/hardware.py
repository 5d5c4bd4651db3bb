"""Whether two cores carry the profile `hardware`: real-time factor, CPU of each process, and how late commands come.

Starts the system with everything the profile names, and measures it standing and walking. CPU is told per second of
robot time, so that a busy machine, which slows the robot down, can still be compared with a quiet one. The observer
listens to what is said a few times a second and no more; `valorctl walk` is the user that it takes to walk.

    .venv/bin/python benchmarks/hardware.py [--seconds 20] [--profile hardware] [--push 20] [--vx 0.3]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
from rich.console import Console
from rich.table import Table

import bifrost
from benchmarks.live_system import push, started, valorctl
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import MotionState
from valor.common.processes import BY_NAME
from valor.common.topics import CLOCK, MOTION_STATE, STATISTICS
from valor.valorctl.leftovers import processes_of

SETTLING = 6.0  # after `up` [s]
PATIENCE = 10.0  # with the system [s]
REST = 0.01  # of the DCM from its reference, at most, when a push is over [m]
LOOKS = 10  # in a row that the robot must be at rest
LOOK_PERIOD = 0.1  # [s]


@dataclass(frozen=True)
class Reading:
    """One look at the system."""

    wall: float  # [s]
    robot: float  # [s]
    cpu: dict[str, float]  # by process, since its start [s]

    def since(self, before: Reading) -> tuple[float, dict[str, float]]:
        """Real-time factor, and CPU per robot second by process [%]."""
        robot = self.robot - before.robot
        cpu = {name: 100.0 * (spent - before.cpu.get(name, 0.0)) / robot for name, spent in self.cpu.items()}
        return robot / (self.wall - before.wall), cpu


class Watch:
    """Reads clock and processes of a running instance."""

    def __init__(self, instance: Instance, node: bifrost.Node) -> None:
        self._clock = CLOCK.subscriber(node)
        self._states = MOTION_STATE.subscriber(node)
        self._emulators = STATISTICS["device_emulators"].subscriber(node)
        self._node = node
        self._processes = {_name(each): each for each in processes_of(instance)}

    def read(self) -> Reading:
        """Look now."""
        if (received := self._clock.receive(PATIENCE)) is None:
            raise ValorError("nobody tells the time")
        cpu = {name: sum(process.cpu_times()[:2]) for name, process in self._processes.items()}
        return Reading(time.monotonic(), 1e-9 * received.message.time, cpu)

    def state(self) -> MotionState:
        """Of the Motion System, the newest from now on."""
        self._states.latest()
        if (received := self._states.receive(PATIENCE)) is None:
            raise ValorError(f"{MOTION_STATE.name} is silent for {PATIENCE:g} s")
        return received.message

    def commands(self) -> str:
        """What the emulated plant says of the commands that it got."""
        received = self._emulators.latest() or self._emulators.receive(PATIENCE)
        return received.message.detail if received else "?"

    def push(self, impulse: float) -> None:
        """Sideways [N·s], until the robot is at rest again; raises ValorError when it does not come to it."""
        push(self._node, (0.0, impulse, 0.0))
        deadline, rested = time.monotonic() + PATIENCE, 0
        while rested < LOOKS:
            time.sleep(LOOK_PERIOD)
            state = self.state()
            off = float(np.hypot(*(state.dcm_in_odom - state.dcm_reference_in_odom)[:2]))
            rested = rested + 1 if state.behavior == "stand" and off < REST else 0
            if time.monotonic() > deadline:
                raise ValorError(
                    f"{state.behavior}, DCM off by {1e3 * off:.0f} mm, {PATIENCE:g} s after a push of {impulse:g} N·s"
                )


def _name(process: psutil.Process) -> str:
    """A row of the table of processes; all others are `valorctl`'s."""
    line = process.cmdline()
    return next((name for name, row in BY_NAME.items() if row.module in line), "supervisor")


def measure(options: argparse.Namespace, home: Path) -> list[tuple[str, float, dict[str, float], str]]:
    """Stand, walk, be pushed; a column each: what, real-time factor, CPU by process, word on the commands."""
    columns = []
    instance = Instance("hardware", home)
    with started(instance, "--profile", options.profile, "--seed", str(options.seed)) as node:
        watch = Watch(instance, node)
        time.sleep(SETTLING)

        def phase(name: str, action: Callable[[], str]) -> None:
            before = watch.read()
            try:
                said = action()
            except ValorError as error:  # what was measured until then is worth telling
                said = str(error)
            factor, cpu = watch.read().since(before)
            columns.append((name, factor, cpu, watch.commands()))
            print(f"{name}: {factor:.3f} × real time; {watch.state().behavior}; {said}; {columns[-1][3]}", flush=True)

        def wait(seconds: float) -> str:
            time.sleep(seconds)
            return ""

        phase("standing", lambda: wait(options.seconds))
        if options.vx:
            phase("walking", lambda: valorctl(instance, "walk", "--vx", str(options.vx), "--for", str(options.seconds)))
        if options.push:
            said = f"at rest after each of {options.pushes} pushes of {options.push:g} N·s sideways"
            try:
                for k in range(options.pushes):
                    watch.push((-1) ** k * options.push)
            except ValorError as error:
                said = str(error)
            print(f"pushed: {watch.state().behavior}; {said}", flush=True)
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
