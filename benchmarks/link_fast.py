"""What the link's fast channel carries: a bag from end to end, alone and under DARPA's kind of schedule, with states.

``python -m benchmarks.link_fast [--size 100] [--seed 3]``: real processes and sockets on this computer.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import psutil
from sensor_msgs.msg import JointState

from benchmarks.link import show
from harness.link_ends import BAG, ENDS, Ends, link_ends
from harness.places import ROBOTS
from harness.waiting import wait_until
from valor.common.linking import robot_ports
from valor.link.emulator import DRC_FAST
from valor.robot.description import RobotDescription

WINDOW = 300e6 / 8.0  # [B]
LISTENING = 29300  # of the emulator, and the next one
APART = 0.75  # of two tellings between which there was a blackout [s]
LONGEST = 900.0  # of a bag [s]


class Joints(threading.Thread):
    """In the robot's place: its joints, a hundred times a second."""

    def __init__(self, ends: Ends) -> None:
        super().__init__(daemon=True)
        names = list(RobotDescription.load(ROBOTS / "escher").joints)
        self._message = JointState(name=names, position=[0.0] * len(names))
        self._publisher = ends.beside._call(ends.beside.node.create_publisher, JointState, "joint_states", 10)
        self._over = threading.Event()

    def run(self) -> None:
        number = 0
        while not self._over.wait(0.01):
            number += 1
            self._message.header.stamp.sec, hundredths = divmod(number, 100)
            self._message.header.stamp.nanosec = 10**7 * hundredths
            self._message.position[number % len(self._message.name)] = 0.001 * (number % 300)
            self._publisher.publish(self._message)

    def stop(self) -> None:
        self._over.set()
        self.join()


def states(ends: Ends) -> int:
    """How many the operator's end has had."""
    values = {pair.key: pair.value for pair in ends.told[-1].values} if ends.told else {}
    return int(values.get("states", 0))


def processor(ends: Ends) -> list[float]:
    """How much of one each end has taken [s]."""
    times = [psutil.Process(ends.running.process(name).pid).cpu_times() for name in ENDS[1:]]
    return [each.user + each.system for each in times]


@dataclass
class Measured:
    """While a bag came.

    Attributes:
        lasted: [s].
        bursts: bytes of each.
        states: that came in each second.
        taken: of a processor, by each end [s].
    """

    lasted: float
    bursts: list[int]
    states: list[int]
    taken: list[float]


def measure(ends: Ends) -> Measured:
    """Have the bag come."""
    name = f"{BAG}.mcap"
    wait_until(lambda: ends.said(name) == "on the robot" and states(ends), 120.0, "the list of bags, and states")
    ends.fetch(name)
    wait_until(lambda: ends.here(name), 120.0, "some of it")
    began, had, taken = time.monotonic(), ends.here(name), processor(ends)
    counted = [states(ends)]
    last, bursts, told = began, [had], had
    while ends.said(name) != "here":
        assert time.monotonic() < began + LONGEST, f"not within {LONGEST:g} s"
        now, here = time.monotonic(), ends.here(name)
        if here > told:
            if now - last > APART:
                bursts.append(0)
            bursts[-1] += here - told
            last, told = now, here
        if now - began >= len(counted):
            counted.append(states(ends))
        time.sleep(0.02)
    lasted = time.monotonic() - began
    assert (ends.running.instance.fetched / name).read_bytes() == ends.content
    each_second = [after - before for before, after in pairwise([*counted, states(ends)] if lasted < 1.0 else counted)]
    return Measured(
        lasted, bursts, each_second, [after - before for before, after in zip(taken, processor(ends), strict=True)]
    )


def run(size: int, seed: int | None) -> list[object]:
    """A line of the table; ``seed``: of blackouts, None: there is nothing between the ends."""
    with tempfile.TemporaryDirectory() as home, link_ends(Path(home), size, 0 if seed is None else LISTENING) as ends:
        to = robot_ports(ends.running.settings)[0]
        command = [sys.executable, "-m", "valor.link.emulate", "--listen", str(LISTENING), "--to", str(to)]
        between = None
        if seed is not None:
            between = subprocess.Popen([*command, "--seed", str(seed)], stdout=subprocess.DEVNULL)
        joints = Joints(ends)
        joints.start()
        try:
            for name in ENDS:
                ends.start(name)
            found = measure(ends)
        finally:
            joints.stop()
            if between is not None:
                between.terminate()
                between.wait()
    if seed is None:
        each = size / found.lasted
        what = "nothing between"
    else:
        whole = sorted(found.bursts[:-1] or found.bursts)  # the last window is not filled
        each = whole[len(whole) // 2]
        what = f"windows of 1 s, {DRC_FAST.bandwidth / 1e6:.0f} Mbit/s"
    load = f"{os.getloadavg()[0]:.1f}"
    return [
        what,
        f"{found.lasted:.1f}",
        len(found.bursts),
        f"{each / 1e6:.1f}",
        f"{100.0 * each / WINDOW:.0f}",
        f"{sum(found.states) / len(found.states):.1f}",
        min(found.states),
        " + ".join(f"{1e9 * each / size:.1f}" for each in found.taken),
        load,
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=float, default=100.0, help="of the bag [MB]")
    parser.add_argument("--seed", type=int, default=3)
    asked = parser.parse_args()
    size = int(1e6 * asked.size)
    head = ["between the ends", "it took [s]", "bursts", "a window [MB]", "of 300 Mbit/s [%]", "states a second",
            "fewest", "of a processor [ms/MB]", "load"]  # fmt: skip
    show("A bag over the fast channel", head, [run(size, None), run(size, asked.seed)])


if __name__ == "__main__":
    main()
