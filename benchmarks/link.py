"""What the link carries: bytes of a state, states a second at 9,600 bit/s, and what becomes of commands at random cuts.

``python -m benchmarks.link BAG [--cuts 1000] [--seed 0]``: the states are those of a recording.
"""

from __future__ import annotations

import argparse
import itertools
import random
import struct
import zlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks.tables import table as titled
from harness.link_bag import states
from harness.link_pair import Pair
from harness.places import ROBOTS
from valor.link.classes import BY_KIND, HEADERS, ROBOT, Kind
from valor.link.codec import Codec, Sender
from valor.link.emulator import DRC_FAST, DRC_SLOW, Conditions
from valor.link.errors import SealError
from valor.link.fields import Layout
from valor.link.schedule import drc_windows
from valor.link.session import OVERHEAD
from valor.link.state import RobotState
from valor.robot.description import RobotDescription

RATE = 10.0  # of states in the recording [Hz]
_PROGRESS = {"plan": (20, 200), "step": (1, 53), "hand": (2, 20)}  # every so many seconds so many bytes
BEHIND = 5  # states, until one is acknowledged
BAD = Conditions(bandwidth=9600.0, delay=0.1, jitter=0.2, loss=0.05, duplication=0.05, reordering=0.05)


def show(title: str, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table."""
    columns = tuple((name, lambda row, place=place: str(row[place])) for place, name in enumerate(head))
    Console(width=160).print(titled(title, columns, rows, left=head[:1]))


def sizes(recorded: list[RobotState], layout: Layout) -> None:
    """Bytes of a state by behavior, and of the same numbers as they are."""
    codec = Codec(layout)
    sender = Sender(codec)
    found: dict[str, list[tuple[int, int, int, int]]] = {}
    for number, state in enumerate(recorded):
        vector = state.vector(layout)
        raw = struct.pack(f"<{layout.size}f", *vector)
        alone = len(codec.encode(codec.quantise(vector)))
        size = (len(sender.encode(vector, number)), alone, len(zlib.compress(raw, 9)), len(raw))
        found.setdefault(state.behavior, []).append(size)
        if number % BEHIND == 0:
            sender.acknowledged(number - BEHIND)
    rows = []
    for behavior, several in [*found.items(), ("all", [size for each in found.values() for size in each])]:
        mean = np.mean(several, axis=0)
        whole = mean[0] + HEADERS + OVERHEAD + 2
        rows.append(
            [behavior, len(several), *(f"{each:.1f}" for each in mean), f"{whole:.0f}", f"{ROBOT.budget / whole:.1f}"]
        )
    head = ["behavior", "states", "predicted [B]", "by itself [B]", "float32, zlib [B]", "float32 [B]",
            "datagram with headers [B]", f"a second at {ROBOT.budget:g} B/s"]  # fmt: skip
    show("A state", head, rows)


def rates(recorded: list[RobotState], layout: Layout, fast: bool) -> None:
    """Bytes a second by class over a recording, of a robot that is kept busy.

    Every 10 s a goal of an arm or a plan, and a mode change; a step begins every second, every two a hand's goal says
    how it fares.
    """
    source = itertools.cycle(recorded)
    windows = drc_windows()
    link = Pair(layout, lambda: next(source), DRC_SLOW, DRC_FAST if fast else None, windows=windows)
    link.until(lambda: link.operator.states, 10.0)
    before, began = link.operator.states, link.now
    chance, told = random.Random(1), dict.fromkeys(_PROGRESS, 0)
    for second in range(60):
        if second % 10 == 0:
            link.operator.send(Kind.COMMAND, chance.randbytes(250), link.now)
            link.operator.send(Kind.COMMAND, b"mode", link.now)
        for name, (period, size) in _PROGRESS.items():
            if second % period == 0:
                content = chance.randbytes(size)
                told[name] = link.robot.renew(Kind.PROGRESS, content, link.robot_time, told[name])
        link.run(1.0)
    lasted = link.now - began
    rows = []
    for name in sorted(link.robot.meter.total | link.operator.meter.total):
        down, up = (end.meter.total[name] / lasted for end in (link.robot, link.operator))
        rows.append([name, f"{down:.0f}", f"{up:.0f}"])
    down, up = (end.meter.total.total() / lasted for end in (link.robot, link.operator))
    rows.append(["all", f"{down:.0f}", f"{up:.0f}"])
    show("Bytes a second, headers included", ["class", "from the robot", "to the robot"], rows)
    per_second = (link.operator.states - before) / lasted
    print(f"states {per_second:.1f} a second, {8 * (down + up):.0f} bit/s both ways, "
          f"{'with' if fast else 'without'} the fast channel; {len(link.executed)} commands obeyed\n")  # fmt: skip


def cuts(layout: Layout, count: int, seed: int) -> None:
    """Commands all the time over a bad link that is cut at random."""
    chance = random.Random(seed)
    times, at = [], 5.0
    for _ in range(count):
        start = at + chance.uniform(0.5, 4.0)
        at = start + chance.choice((0.2, 2.0, 5.0))
        times.append((start, at))
    still = RobotState(joints=np.zeros(layout.joints.stop - layout.joints.start), mode_age=0.0, behavior_age=0.0)
    link = Pair(layout, lambda: still, BAD, seed=seed, cuts=times)
    sent: dict[bytes, float] = {}
    flattered = 0
    while link.now < at + 10.0:
        link.step()
        if (state := link.operator.state) is not None:
            true = link.robot_time - (state.clock / 1e3 + link.robot._born)
            flattered += link.operator.age(link.now) < true - 2e-3
        if chance.random() < 0.02:
            content = str(len(sent)).encode()
            try:
                link.operator.send(Kind.COMMAND, content, link.now)
            except SealError:
                continue
            sent[content] = link.now
    counts = Counter(content for _, _, content in link.executed)
    lasts = BY_KIND[Kind.COMMAND].deadline or 0.0
    late = sum(when - sent[content] > lasts + 0.05 for when, _, content in link.executed)
    rows = [[count, f"{link.now:.0f}", len(sent), len(counts), len(link.refused), len(sent) - len(counts),
             sum(each > 1 for each in counts.values()), late, flattered]]  # fmt: skip
    head = ["cuts", "simulated [s]", "commands", "obeyed", "refused as late", "not obeyed", "obeyed twice",
            "obeyed late", "ages told too low"]  # fmt: skip
    show("Commands over a bad link", head, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--cuts", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    robot = RobotDescription.load(ROBOTS / "escher")
    layout = Layout(robot)
    recorded = states(asked.bag, robot, RATE)
    sizes(recorded, layout)
    rates(recorded, layout, fast=False)
    rates(recorded, layout, fast=True)
    cuts(layout, asked.cuts, asked.seed)


if __name__ == "__main__":
    main()
