"""How far apart set-points are in robot time beside processes that want every core, and what waiting for the VRC costs.

A robot swings an arm by trajectories, again and again; each round once with robot time waiting for the VRC's cycles and
once without, alone and beside so many busy loops. A gap is the robot time between two JointSetpoints of one trajectory.

    .venv/bin/python benchmarks/setpoint_gaps.py [--seconds 10] [--rounds 2] [--loops 4]
"""

from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

import bifrost
from benchmarks.tables import table
from harness.instance import RunningInstance, fresh_instance
from harness.system import RosClient
from harness.waiting import wait_until
from valor.common.messages import JointSetpoints
from valor.common.topics import JOINT_SETPOINTS

LONG = 0.0085  # more than two cycles of the VRC [s]
PATIENCE = 300.0  # [s]
SWING, PART = 0.3, 2.0  # there and back [rad], each in so long [s]
PROCESSES = ("comms_manager", "motion_manager", "valor_ros_controller")


@dataclass
class Row:
    """What one swinging of the arm has shown."""

    waits: bool
    loops: int
    gaps: list[float]  # [s]
    factor: float  # robot time over the wall's


@contextlib.contextmanager
def busy(loops: int) -> Iterator[None]:
    """So many processes that never wait."""
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(loops)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def swing(instance: RunningInstance, ros: RosClient, waits: bool, loops: int, seconds: float) -> Row:
    """Swing the right arm for so long in robot time."""
    with bifrost.Node("gaps", network=instance.network) as node:
        heard = JOINT_SETPOINTS.subscriber(node, queue=100_000)
        wait_until(lambda: heard.drain() is not None and heard.publishers, PATIENCE, "the VRC")
        began, home = time.perf_counter(), ros.joint_positions()["r_elbow_pitch"]
        first = last = 0
        gaps: list[float] = []
        for part in range(max(2, round(seconds / PART))):
            answer = ros.follow("right_arm", [(PART, _pose(ros, home + SWING * (1 - part % 2)))], PATIENCE)
            assert answer.result.error_code == 0, answer.result.error_string
            stamps = [_stamp(received.message) for received in heard.drain()]
            first, last = first or stamps[0], stamps[-1]
            gaps += (np.diff(stamps) * 1e-9).tolist()
        return Row(waits, loops, gaps, (last - first) * 1e-9 / (time.perf_counter() - began))


def _stamp(message: JointSetpoints) -> int:
    return message.time


def _pose(ros: RosClient, elbow: float) -> dict[str, float]:
    """The right arm as it is, but for the elbow."""
    arm = {name: value for name, value in ros.joint_positions().items() if name.startswith(("r_shoulder", "r_wrist"))}
    return arm | {"r_elbow_pitch": elbow, "r_elbow_roll": ros.joint_positions()["r_elbow_roll"]}


def measure(waits: bool, loops: tuple[int, ...], seconds: float) -> list[Row]:
    """One robot, alone and beside busy loops."""
    with (
        tempfile.TemporaryDirectory(prefix="valor-", ignore_cleanup_errors=True) as home,
        fresh_instance(Path(home), "gaps", real_time_factor=1.0, wait_for_vrc=waits) as instance,
    ):
        for process in PROCESSES:
            instance.start(process)
        instance.wait_ready(PROCESSES[-1], PATIENCE)
        ros = RosClient(instance.environment)
        try:
            for mode in ("stand", "stand_manipulate"):
                wait_until(
                    lambda mode=mode: ros.change_mode(mode, PATIENCE).current_control_mode == mode,  # type: ignore[misc]
                    PATIENCE, f"control mode {mode}", period=0.2,
                )  # fmt: skip
            rows = []
            for count in loops:
                with busy(count):
                    rows.append(swing(instance, ros, waits, count, seconds))
            return rows
        finally:
            ros.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--loops", type=int, default=4)
    arguments = parser.parse_args()
    rows = [
        row
        for _ in range(arguments.rounds)
        for waits in (False, True)
        for row in measure(waits, (0, arguments.loops), arguments.seconds)
    ]
    rows.sort(key=lambda row: (row.loops, row.waits))
    Console(width=110).print(
        table(
            "gaps between set-points, in robot time",
            (
                ("busy loops", lambda row: str(row.loops)),
                ("waits", lambda row: "yes" if row.waits else "no"),
                ("set-points", lambda row: str(len(row.gaps) + 1)),
                (f"above {1e3 * LONG:g} ms", lambda row: str(sum(gap > LONG for gap in row.gaps))),
                ("longest [ms]", lambda row: f"{1e3 * max(row.gaps):.0f}"),
                ("real-time factor", lambda row: f"{row.factor:.2f}"),
            ),
            rows,
        )
    )


if __name__ == "__main__":
    main()
