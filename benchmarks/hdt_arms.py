"""What the detour of the HDT arms costs: from a command over bridge, driver and modules to the state that answers it.

Starts the hardware variant, lets the robot stand, and listens on Bifrost to commands and states of every limb. Stamps
are those of publication, by one monotonic clock.

    .venv/bin/python benchmarks/hdt_arms.py [--seconds 20] [--profile hardware]
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import bifrost
from benchmarks.live_system import System, running
from valor.common.instance import Instance
from valor.common.messages import Statistics
from valor.common.topics import HDT_COMMANDS, HDT_STATES, STATISTICS

LIMBS = tuple(HDT_COMMANDS)
PROCESSES = ("hdt_driver", "hdt_bridge", "comms_manager", "device_emulators")


class Listener:
    """Commands and states of one limb, with when each was published [s]."""

    def __init__(self, node: bifrost.Node, limb: str) -> None:
        self._commands = HDT_COMMANDS[limb].subscriber(node, queue=10_000)
        self._states = HDT_STATES[limb].subscriber(node, queue=10_000)
        self._sent: dict[int, float] = {}
        self.latencies: list[float] = []  # of commands that acted [s]
        self.came: list[float] = []  # states

    def hear(self) -> None:
        """Take in what has come."""
        for command in self._commands.drain():
            self._sent[command.message.sequence] = 1e-9 * command.stamp
        for state in self._states.drain():
            self.came.append(1e-9 * state.stamp)
            if (sent := self._sent.pop(state.message.command_sequence, None)) is not None:
                self.latencies.append(self.came[-1] - sent)


def measure(system: System, seconds: float) -> tuple[dict[str, Listener], dict[str, list[Statistics]]]:
    """Listen for a while."""
    limbs = {limb: Listener(system.node, limb) for limb in LIMBS}
    fares = {name: STATISTICS[name].subscriber(system.node, queue=1000) for name in PROCESSES}
    said: dict[str, list[Statistics]] = {name: [] for name in PROCESSES}
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        time.sleep(0.1)
        system.observer.hear()
        for limb in limbs.values():
            limb.hear()
        for name, subscriber in fares.items():
            said[name] += [received.message for received in subscriber.drain()]
    return limbs, said


def report(console: Console, limbs: dict[str, Listener], said: dict[str, list[Statistics]]) -> None:
    """Two tables."""
    table = Table("limb", "states [Hz]", "p50 [ms]", "p90 [ms]", "p99 [ms]", title="from a command to its state")
    for name, limb in limbs.items():
        rate = (len(limb.came) - 1) / (limb.came[-1] - limb.came[0])
        quantiles = 1e3 * np.quantile(limb.latencies, (0.5, 0.9, 0.99))
        table.add_row(name, f"{rate:.1f}", *(f"{each:.1f}" for each in quantiles))
    console.print(table)
    table = Table("process", "CPU [% of a core]", "memory [MiB]", "overruns", title="processes")
    for name, words in said.items():
        cpu, memory = (np.median([getattr(word, what) for word in words]) for what in ("cpu_percent", "memory_mib"))
        table.add_row(name, f"{cpu:.1f}", f"{memory:.0f}", str(words[-1].overruns - words[0].overruns))
    console.print(table)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--profile", default="hardware")
    arguments = parser.parse_args()
    console = Console()
    with tempfile.TemporaryDirectory(prefix="valor-") as home:
        instance = Instance("hdt-arms", Path(home))
        with running(instance, {"profile": arguments.profile}, lambda _: None) as system:
            limbs, said = measure(system, arguments.seconds)
    report(console, limbs, said)
    console.print(f"load of the machine: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
