"""Figure 5.1 and table 5.2: latency of a double over Bifrost and over ROS."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from thesis.analysis.figures import make_room
from thesis.experiments import ipc_peer
from thesis.experiments.experiment import Run
from thesis.experiments.ipc_peer import DEADLINE, TRANSPORTS
from thesis.report.results import Measure, Table
from valor.analysis import style
from valor.analysis.bands import bands
from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.valorctl.terminal.console import bar

RATE = 10.0  # [Hz]
SECONDS, QUICK = 40.0, 2.0  # of a run
RUNS = {"threads": 3, "processes": 1}  # between new ends; two minutes of the thesis' way
NO_ROBOT = "no robot: the two transports alone"  # instead of a behavior
_NAMES = {"bifrost": "Bifrost", "ros": "ROS 2 (rclpy, Fast DDS)"}
_THESIS = {"bifrost": ("202.3", "24.6"), "ros": ("165.5", "25.5")}
_WHY = {"bifrost": "over TCP in both, encrypted here", "ros": "ROS 1 over TCP there, ROS 2 over UDP and Python here"}
_WAYS = {"threads": "thread to thread", "processes": "process to process"}


def run(run: Run) -> None:
    """Send ten messages a second over both transports, between threads and between processes, in several runs."""
    count = int(RATE * (QUICK if run.options.quick else SECONDS))
    runs: dict[tuple[str, str], list[FloatArray]] = {(way, name): [] for way in _WAYS for name in _NAMES}
    with run.system(profile="bifrost"):
        for way in _WAYS:
            for _ in range(1 if run.options.quick else RUNS[way]):
                # Both transports concurrently, so that other load affects both alike.
                for name, one in measure(run, way, RATE, count).items():
                    runs[way, name].append(one)
    latencies = {key: np.concatenate(each) for key, each in runs.items()}
    run.text = (
        f"A publisher sends a double that grows, {RATE:.0f} times a second, and notes when; a subscriber notes when "
        f"each arrives: in runs of {count} messages, each between new ends. Both over the loopback interface, "
        "Bifrost encrypted (CURVE). Idle cores sleep and take long to wake: at ten messages a second the computer's "
        "wake-up time is part of each latency."
    )
    run.tables.append(
        Table(
            "Latency of one double [µs]",
            ["", "mean", "of each run", "sd", "median", "p99", "lost"],
            [
                [f"{_NAMES[name]}, {_WAYS[way]}", f"{1e6 * x.mean():.1f}", _means(runs[way, name]),
                 *(f"{1e6 * value:.1f}" for value in (x.std(), np.median(x), np.quantile(x, 0.99))),
                 str(len(runs[way, name]) * count - len(x))]
                for (way, name), x in latencies.items()
            ],
        )
    )  # fmt: skip
    for name, (mean, sd) in _THESIS.items():
        x = 1e6 * latencies["threads", name]
        run.measures += [
            Measure(f"{_NAMES[name]}, mean", float(x.mean()), "µs", mean,
                    f"one double, thread to thread, 10 Hz; {_WHY[name]}; median {np.median(x):.0f}; runs: "
                    f"{_means(runs['threads', name])}"),
            Measure(f"{_NAMES[name]}, sd", float(x.std()), "µs", sd,
                    "how evenly a core wakes from sleep, and what else it does (see the load)"),
        ]  # fmt: skip
    ratio = float(latencies["threads", "bifrost"].mean() / latencies["threads", "ros"].mean())
    run.measures.append(Measure("Bifrost against ROS, mean", ratio, "×", "1.22",
                                "below 1: Bifrost is the quicker, the other way round than there"
                                if ratio < 1.0 else "above 1: ROS is the quicker, as there"))  # fmt: skip
    run.files.append(_write_csv(latencies, run.out / "ipc_latency.csv"))
    run.picture([_plot(latencies, run.out / "ipc_latency.png")],
                "Latency of each message over time, run after run; the lines are trends.", "Figure 5.1")  # fmt: skip


def _means(runs: Sequence[FloatArray]) -> str:
    """Mean of each run [µs], as text."""
    return ", ".join(f"{1e6 * one.mean():.0f}" for one in runs)


def measure(run: Run, way: str, rate: float, count: int) -> dict[str, FloatArray]:
    """Send doubles over both transports concurrently, in a running system.

    Args:
        run: the experiment.
        way: between ``threads`` or ``processes``.
        rate: of the messages [Hz].
        count: of them.

    Returns:
        Latencies [s], by transport.

    Raises:
        ValorError: fewer than two arrived, or the two ends did not finish.
    """
    environment = os.environ | run.instance.environment()
    # The receiving end starts first; the sending end waits until it has discovered it.
    roles = ("both",) if way == "threads" else ("receive", "publish")
    notes = {(name, role): run.out / f".{name}_{way}_{role}" for name in TRANSPORTS for role in roles}
    peers: list[subprocess.Popen[bytes]] = []
    try:
        for (name, role), file in notes.items():
            with open(file, "wb") as out:
                peers.append(
                    subprocess.Popen(
                        [sys.executable, "-m", ipc_peer.__name__, name, role, str(rate), str(count)],
                        env=environment, stdout=out, start_new_session=True,
                    )
                )  # fmt: skip
        began, whole = time.monotonic(), count / rate
        with bar(_WAYS[way], whole, "s") as shown:
            while any(peer.poll() is None for peer in peers):
                run.interruption.check()
                elapsed = time.monotonic() - began
                if elapsed > whole + 4.0 * DEADLINE:
                    raise ValorError(f"latency {_WAYS[way]}: the two ends did not finish in time")
                shown(min(elapsed, whole))
                time.sleep(0.05)
        return {
            name: _match(name, [file.read_text() for (other, _), file in notes.items() if other == name])
            for name in TRANSPORTS
        }
    finally:
        for peer in peers:
            peer.kill()
            peer.wait()
        for file in notes.values():
            file.unlink(missing_ok=True)


def _match(name: str, notes: list[str]) -> FloatArray:
    """Latencies of the messages received [s]."""
    times: dict[str, dict[int, int]] = {"sent": {}, "received": {}}
    for line in "".join(notes).splitlines():
        word, number, at = line.split()
        times[word][int(number)] = int(at)
    sent, received = times["sent"], times["received"]
    if len(received) < 2:
        raise ValorError(f"latency over {_NAMES[name]}: {len(received)} of {len(sent)} messages arrived")
    return np.array([received[number] - sent[number] for number in sorted(received)]) * 1e-9


def _write_csv(latencies: Mapping[tuple[str, str], FloatArray], file: Path) -> Path:
    with open(file, "w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(("way", "transport", "message", "latency_us"))
        for (way, name), x in latencies.items():
            writer.writerows((_WAYS[way], _NAMES[name], i, f"{1e6 * value:.1f}") for i, value in enumerate(x))
    return file


def _plot(latencies: Mapping[tuple[str, str], FloatArray], file: Path) -> Path:
    figure = style.figure(11.0, 4.6)
    grid = figure.add_gridspec(1, 2, left=0.07, right=0.985, bottom=0.2, top=0.80, wspace=0.14)
    top = 1.2e6 * max(float(np.quantile(x, 0.99)) for x in latencies.values())
    for column, (way, title) in enumerate(_WAYS.items()):
        axes = figure.add_subplot(grid[column])
        style.quiet(axes, title, "time [s]", "latency [µs]" if column == 0 else "")
        for (name, label), color in zip(_NAMES.items(), style.SERIES, strict=False):
            x = 1e6 * latencies[way, name]
            at = np.arange(len(x)) / RATE
            axes.plot(at, x, ".", color=color, markersize=3.0, alpha=0.6, label=label)
            axes.plot(at, np.polyval(np.polyfit(at, x, 1), at), color=color, linewidth=1.6)
        axes.set_xlim(0.0, len(x) / RATE)
        axes.set_ylim(0.0, top)
        make_room(axes)
        bands(axes, np.array(axes.get_xlim()), np.array([NO_ROBOT, NO_ROBOT]))
    style.legend(figure, axes.get_legend_handles_labels()[0], loc="lower center", ncols=2)
    style.heading(figure, "One double over Bifrost and over ROS 2", f"{RATE:.0f} messages a second; a point a message")
    return style.save(figure, file)
