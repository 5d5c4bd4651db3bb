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
from harness.emulated_channel import DRC_FAST, DRC_SLOW, Conditions, drc_windows
from harness.link_pair import Pair
from harness.places import ROBOTS
from valor.analysis.reading.bag import Bag
from valor.common.arrays import FloatArray
from valor.common.instance import LINK_RATE
from valor.link.classes import BY_CLASS, HEADERS, MessageClass, rates
from valor.link.codec import Codec, Sender
from valor.link.errors import SealError
from valor.link.fields import Layout
from valor.link.session import OVERHEAD
from valor.link.state import RobotState
from valor.robot.description import RobotDescription
from valor.ros.limbs import FEET, WRENCH


def states(file: Path, robot: RobotDescription, rate: float) -> list[RobotState]:
    """Those of a bag, ``rate`` a second of robot time."""
    bag = Bag(file)
    joints, odometry, mode = bag["/joint_states"], bag["/odom"], bag["/flor/controller/mode"]
    motion = bag["/flor/controller/motion_state"]
    feet = [bag[f"/{WRENCH.format(foot)}"] for foot in FEET]
    order = [joints.messages[0].name.index(name) for name in robot.joints]
    start, end = joints.time[0], joints.time[-1]
    found = []
    for now in np.arange(start + 0.5, end, 1.0 / rate):
        at = {each.topic: int(np.searchsorted(each.time, now, side="right")) - 1 for each in
              (joints, odometry, mode, motion, *feet)}  # fmt: skip
        last = {each.topic: each.messages[max(at[each.topic], 0)] for each in (joints, odometry, mode, motion, *feet)}
        pose, twist = last["/odom"].pose.pose, last["/odom"].twist.twist
        wrenches = [last[each.topic].wrench for each in feet]
        told = last[mode.topic]
        found.append(RobotState(
            joints=np.asarray(last["/joint_states"].position)[order],
            clock=round(1e3 * now), stamp=round(1e3 * joints.time[at["/joint_states"]]),
            base_position=_vector(pose.position),
            base_orientation=np.array((pose.orientation.w, *_vector(pose.orientation))),
            base_velocity=_vector(twist.linear), base_turn=_vector(twist.angular),
            foot_forces=np.concatenate([_vector(each.force) for each in wrenches]),
            foot_torques=np.concatenate([_vector(each.torque) for each in wrenches]),
            mode=told.current_control_mode, requested_mode=told.requested_control_mode, mode_status=told.status,
            mode_age=min(1.0, now - mode.time[max(at[mode.topic], 0)]), behavior=last[motion.topic].behavior,
            behavior_age=0.05, contacts=int(last[motion.topic].contacts[0]) + 2 * int(last[motion.topic].contacts[1]),
            fault_level=0,
        ))  # fmt: skip
    return found


def _vector(each: object) -> FloatArray:
    return np.array([getattr(each, axis) for axis in "xyz"])


ROBOT = rates(LINK_RATE, True)
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


def loads(recorded: list[RobotState], layout: Layout, fast: bool) -> None:
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
            link.operator.send(MessageClass.COMMAND, chance.randbytes(250), link.now)
            link.operator.send(MessageClass.COMMAND, b"mode", link.now)
        for name, (period, size) in _PROGRESS.items():
            if second % period == 0:
                content = chance.randbytes(size)
                told[name] = link.robot.replace(MessageClass.PROGRESS, content, link.robot_time, told[name])
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
            true = link.robot_time - (state.clock / 1e3 + link.robot._started)
            flattered += link.operator.age(link.now) < true - 2e-3
        if chance.random() < 0.02:
            content = str(len(sent)).encode()
            try:
                link.operator.send(MessageClass.COMMAND, content, link.now)
            except SealError:
                continue
            sent[content] = link.now
    counts = Counter(content for _, _, content in link.executed)
    lasts = BY_CLASS[MessageClass.COMMAND].deadline or 0.0
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
    loads(recorded, layout, fast=False)
    loads(recorded, layout, fast=True)
    cuts(layout, asked.cuts, asked.seed)


if __name__ == "__main__":
    main()
