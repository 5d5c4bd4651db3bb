"""What the Whole-Body Controller costs and achieves, plant and controller in one process.

Prints Markdown tables: the time of a tick, standing over seeds, the largest push survived in each direction with fixed
feet against the bound of physics m·ω·Δξ (the DCM must stay within reach of the centre of pressure), the largest one
survived by stepping, walking, pushes at any phase of a walk, and the ways over dirt, rubble and stairs.

    .venv/bin/python benchmarks/control.py [ticks] [standing] [fixed] [stepping] [walking] [pushed] [courses]
        [--profile hardware] [--seeds 3] [--seconds 60]
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the services run; NumPy reads it once
sys.path.insert(0, str(Path(__file__).parents[1]))  # for the closed loop, which the tests share

import numpy as np
import pushes
import walks

from tests.unit.whole_body.closed_loop import ClosedLoop, load_robot
from valor_common.robot import RobotDescription


def main() -> None:
    """Run what the command line asks for; everything by default."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "what", nargs="*", help="ticks, standing, fixed, stepping, walking, pushed, courses; default: all"
    )
    parser.add_argument("--robot", default="escher")
    parser.add_argument("--profile", default="hardware")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=60.0, help="of standing, for each seed")
    options = parser.parse_args()
    robot = load_robot(options.robot)
    parts = {
        "ticks": lambda: ticks(robot, options.profile),
        "standing": lambda: standing(robot, options.profile, options.seeds, options.seconds),
        "fixed": lambda: pushes.fixed(options.robot, options.profile, options.seeds),
        "stepping": lambda: pushes.stepping(options.robot, options.profile, options.seeds),
        "walking": lambda: walks.walking(options.robot, options.profile, options.seeds),
        "pushed": lambda: pushes.walking(options.robot, options.profile, options.seeds),
        "courses": lambda: walks.courses(options.robot, options.profile, options.seeds),
    }
    for name in options.what or parts:
        for line in parts[name]():
            print(line, flush=True)


def ticks(robot: RobotDescription, profile: str) -> Iterator[str]:
    """Time of estimator, fall detection and controller together, in the loop with the plant between ticks."""
    loop = ClosedLoop(robot, profile)
    loop.settle(0.3)
    loop.run(1.0)
    gc.collect()
    gc.freeze()
    gc.disable()
    loop.tick_times.clear()
    load, began, cpu = os.getloadavg()[0], time.perf_counter(), time.thread_time()
    loop.run(10.0)
    share = (time.thread_time() - cpu) / (time.perf_counter() - began)
    gc.enable()
    p10, p50, p99 = np.percentile(loop.tick_times, (10, 50, 99)) * 1e6
    yield f"\n## {len(loop.tick_times)} ticks, {profile}, load {load:.1f}, {100 * share:.0f} % of a core to ourselves\n"
    yield "| p10 [µs] | p50 [µs] | p99 [µs] | of the period, p50 |\n|---|---|---|---|"
    yield f"| {p10:.0f} | {p50:.0f} | {p99:.0f} | {1e-4 * p50 / robot.control_period:.0f} % |"


def standing(robot: RobotDescription, profile: str, seeds: int, seconds: float) -> Iterator[str]:
    """How still the robot stands, after five seconds to settle."""
    yield f"\n## Standing {seconds:.0f} s, {profile}\n"
    yield (
        "| seed | pelvis height, largest − smallest [mm] | height error, mean [mm] | DCM error RMS x, y, z [mm] "
        "| CoP RMS about its mean x, y [mm] | QP's foot forces − felt, RMS [N] "
        "| largest torque change a tick, RMS [% of limit] | QP failures | fall |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    for seed in range(seeds):
        loop = ClosedLoop(robot, profile, seed)
        loop.settle(0.5)
        loop.run(5.0)
        height, dcm, cop, force, effort = record(loop, seconds)
        x, y, z = np.sqrt(np.mean(np.square(dcm), axis=0)) * 1e3
        cx, cy = np.std(cop, axis=0) * 1e3
        chatter = (np.diff(effort, axis=0).std(axis=0) / robot.effort_limit).max() * 100
        offset = np.mean(height) - robot.tables.nominal_base_height
        yield (
            f"| {seed} | {np.ptp(height) * 1e3:.1f} | {offset * 1e3:+.1f} "
            f"| {x:.1f}, {y:.1f}, {z:.1f} | {cx:.1f}, {cy:.1f} | {np.sqrt(np.mean(np.square(force))):.1f} "
            f"| {chatter:.2f} | {loop.command.qp_failures} | {loop.fall or '–'} |"
        )


def record(loop: ClosedLoop, seconds: float) -> list[np.ndarray]:
    """True pelvis height, DCM error, CoP, error of the feet's planned forces, and torques, every period."""
    rows: list[tuple[object, ...]] = []
    loop.run(
        seconds,
        lambda loop: rows.append(
            (
                loop.plant.data.qpos[2],
                loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom,
                loop.state.cop_in_odom,
                loop.command.desired_foot_forces - loop.state.foot_forces,
                loop.command.effort,
            )
        ),
    )
    return [np.array(column) for column in zip(*rows, strict=True)]


if __name__ == "__main__":
    main()
