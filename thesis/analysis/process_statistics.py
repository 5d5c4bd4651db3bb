"""CPU and memory of processes over time, and table 5.1 of them.

Percent of one core since the previous sample, from the same counters as ``top``.
"""

from __future__ import annotations

import contextlib
import csv
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np
import numpy.typing as npt
import psutil

from thesis.analysis.figures import make_room
from thesis.errors import SignalError
from valor.analysis import style
from valor.analysis.bands import bands
from valor.common.arrays import FloatArray

_MIB = 2.0**20


@dataclass(frozen=True)
class Usage:
    """Samples of one process, n of them.

    Attributes:
        time: (n,) since the start of sampling [s].
        cpu: (n,) since the previous sample [% of one core].
        memory: (n,) resident [MiB].
    """

    time: FloatArray
    cpu: FloatArray
    memory: FloatArray


class Sampler:
    """Samples processor time and memory of processes.

    Attributes:
        began: start of sampling, monotonic [s].
    """

    def __init__(self, pids: Mapping[str, int], families: Collection[str] = ()) -> None:
        """Start sampling.

        Args:
            pids: of the processes, by name.
            families: names of those that count together with their descendants.

        Raises:
            SignalError: a process does not run; names it.
        """
        self._families = families
        self._processes: dict[str, psutil.Process] = {}
        self.began = time.monotonic()
        self._rows: dict[str, list[tuple[float, float, float]]] = {name: [] for name in pids}
        self._before: dict[str, tuple[float, float]] = {}
        for name, pid in pids.items():
            try:
                self._processes[name] = psutil.Process(pid)
                self._before[name] = (time.monotonic(), self._seconds(name))
            except psutil.NoSuchProcess:
                raise SignalError(f"{name}: no process {pid}") from None

    def sample(self) -> None:
        """Sample every process.

        Raises:
            SignalError: a process has ended; names it.
        """
        for name in self._processes:
            try:
                now, used = time.monotonic(), self._seconds(name)
                memory = self._sum(name, lambda one: one.memory_info().rss) / _MIB
            except psutil.NoSuchProcess:
                raise SignalError(f"{name}: ended while it was measured") from None
            before, used_before = self._before[name]
            self._before[name] = now, used
            self._rows[name].append((now - self.began, 100.0 * (used - used_before) / (now - before), memory))

    def usage(self) -> dict[str, Usage]:
        """Samples by process."""
        return {name: Usage(*np.array(rows, dtype=np.float64).reshape(-1, 3).T) for name, rows in self._rows.items()}

    def _seconds(self, name: str) -> float:
        return self._sum(name, lambda one: sum(one.cpu_times()[:2]))

    def _sum(self, name: str, of: Callable[[psutil.Process], float]) -> float:
        """Sum over a process, and over its descendants if it is a family; those may end at any time."""
        process = self._processes[name]
        total = of(process)
        for each in process.children(recursive=True) if name in self._families else ():
            with contextlib.suppress(psutil.NoSuchProcess):
                total += of(each)
        return total


def write_csv(usage: Mapping[str, Usage], file: Path) -> Path:
    """Write one row per sample and process."""
    with open(file, "w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(("process", "time_s", "cpu_percent", "memory_mib"))
        for name, one in usage.items():
            for row in zip(one.time, one.cpu, one.memory, strict=True):
                writer.writerow((name, *(f"{value:.3f}" for value in row)))
    return file


def plot(usage: Mapping[str, Usage], behavior: tuple[FloatArray, npt.NDArray[np.str_]], file: Path) -> Path:
    """Plot processor and memory of every process over time, with the behaviors.

    Args:
        usage: by process.
        behavior: times on the axis of the samples [s], and the behavior at each.
        file: of the picture.
    """
    figure = style.figure(11.0, 6.2)
    grid = figure.add_gridspec(2, 1, left=0.075, right=0.985, bottom=0.17, top=0.86, hspace=0.38)
    above, below = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    style.quiet(above, "processor", "", "[% of one core]")
    style.quiet(below, "memory", "time [s]", "resident [MiB]")
    for (name, one), color in zip(usage.items(), cycle((*style.SERIES, style.GREY)), strict=False):
        above.plot(one.time, one.cpu, color=color, linewidth=1.0, label=name)
        below.plot(one.time, one.memory, color=color, linewidth=1.4, label=name)
    seconds = max((float(one.time[-1]) for one in usage.values() if one.time.size), default=0.0)
    for axes in (above, below):
        axes.set_xlim(0.0, max(seconds, 1e-3))
        axes.set_ylim(bottom=0.0)
        make_room(axes)
        bands(axes, *behavior)
    style.legend(figure, above.get_legend_handles_labels()[0], loc="lower center", ncols=3)
    style.heading(figure, "Processes while the robot stands", f"{seconds:.0f} s, every process of the system")
    return style.save(figure, file)
