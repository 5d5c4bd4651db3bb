"""What the Whole-Body Controller costs and achieves, plant and controller in one process.

Prints Markdown tables: the time of a tick, standing over seeds, the largest push survived in each direction with fixed
feet against the bound of physics m·ω·Δξ (the DCM must stay within reach of the centre of pressure), the largest one
survived by stepping, walking, pushes at any phase of a walk, the ways over dirt, rubble and stairs, and actuator
profiles, natural frequencies, and robots with fewer sensors side by side.

    .venv/bin/python benchmarks/control.py [ticks] [standing] [fixed] [stepping] [walking] [pushed] [courses] [profiles]
        [frequencies] [feet] [--profile hardware] [--seeds 3] [--seconds 60]
"""

from __future__ import annotations

import argparse
import functools
import gc
import os
import time
from collections.abc import Callable, Iterator

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the services run; NumPy reads it once

import numpy as np

from benchmarks import feet, frequencies, profiles, pushes, walks
from harness.closed_loop import ClosedLoop, load_robot
from harness.strangers import ROBOTS
from valor.robot.description import RobotDescription
from valor.whole_body.walking.velocity_steps import VelocitySteps


def main() -> None:
    """Run what the command line asks for; everything by default."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "what",
        nargs="*",
        help="ticks, standing, fixed, stepping, walking, pushed, courses, profiles, frequencies, feet; default: all",
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
        "profiles": lambda: profiles.table(
            options.robot, [p for p in PROFILES if p in robot.tables.actuators], options.seeds
        ),
        "courses": lambda: walks.courses(options.robot, options.profile, options.seeds),
        "frequencies": lambda: frequencies.table(options.robot, options.profile, options.seeds),
        "feet": lambda: feet.table((options.robot, *ROBOTS), options.profile, options.seeds),
    }
    for name in options.what or parts:
        for line in parts[name]():
            print(line, flush=True)


def ticks(robot: RobotDescription, profile: str) -> Iterator[str]:
    """Time of estimator, fall detection and controller together, and where it goes, standing and walking.

    Twice each: in the loop with the plant between ticks; and paced as a live system is, with caches emptied between
    ticks, which is what other processes do to it.
    """
    yield f"\n## A tick, {profile}, load {os.getloadavg()[0]:.1f}\n"
    yield "| robot | caches | p10 [µs] | p50 [µs] | p99 [µs] | of the period, p50 | of a core, ours |"
    yield "|---|---|---|---|---|---|---|"
    stages: dict[str, list[str]] = {}
    runs = [(speed, cold) for speed in (0.0, 0.4) for cold in (False, True)]
    for speed, cold in runs:
        times, share, _ = timed(robot, profile, speed, cold=cold, stages={})
        p10, p50, p99 = np.percentile(times, (10, 50, 99)) * 1e6
        yield (
            f"| {'walks' if speed else 'stands'} | {'cold' if cold else 'warm'} | {p10:.0f} | {p50:.0f} | {p99:.0f} "
            f"| {1e-4 * p50 / robot.control_period:.0f} % | {100 * share:.0f} % |"
        )
        for name, spent in timed(robot, profile, speed, cold=cold, stages=STAGES)[2].items():
            stages.setdefault(name, []).append(f"{np.median(spent) * 1e6:.0f}")
    yield "\nWhere it goes, medians [µs], each with some 0.5 µs of being measured:\n"
    yield "| stage | stands, warm | stands, cold | walks, warm | walks, cold |\n|---|---|---|---|---|"
    for name, medians in stages.items():
        yield f"| {name} | {' | '.join(medians)} |"


PROFILES = ("ideal", "hardware", "series_elastic")
"""Columns of ``profiles``, where the robot has them."""

STAGES = {
    "estimator": "estimator.update",
    "– of it MuJoCo's kinematics and dynamics": "estimator.kinematics.evaluate",
    "fall detection": "detector.update",
    "controller": "controller.update",
    "– gait, swinging foot, adjustment": "controller._step",
    "– references, tasks, joint limits": "controller._desired.update",
    "– self-collision": "controller._bounds",
    "– objective": "controller._objective.update",
    "– contact forces": "controller._contacts.update",
    "– QP": "controller._qp.solve",
    "– – of it DAQP": "controller._qp._minimum",
    "– set-points": "controller._command",
}
"""What is timed → the method of ``ClosedLoop`` that does it."""


def timed(
    robot: RobotDescription, profile: str, speed: float, *, cold: bool, stages: dict[str, str]
) -> tuple[list[float], float, dict[str, list[float]]]:
    """Ticks of six seconds [s], the share of a core that they had, and how long each stage took [s]."""
    loop = ClosedLoop(robot, profile)
    loop.settle(0.3)
    loop.run(1.0)
    spent: dict[str, list[float]] = {name: [] for name in stages}
    for name, path in stages.items():
        *owners, method = path.split(".")
        owner = functools.reduce(getattr, owners, loop)
        setattr(owner, method, stopwatch(getattr(owner, method), spent[name]))
    source = VelocitySteps(robot.tables.walking)
    if speed:
        loop.request.steps = source
    evicted = np.zeros(4 << 20, dtype=np.uint8)
    due = time.perf_counter()

    def each(loop: ClosedLoop) -> None:
        nonlocal due
        source.command(np.array((speed, 0.0, 0.0)), loop.time)
        source.advance(loop.time)
        if cold:
            np.add(evicted, 1, out=evicted)
            due = max(due + robot.control_period, time.perf_counter())
            time.sleep(due - time.perf_counter() if due > time.perf_counter() else 0.0)

    loop.run(2.0, each)
    gc.collect()
    gc.freeze()
    gc.disable()
    loop.tick_times.clear()
    for times in spent.values():
        times.clear()
    began, cpu = time.perf_counter(), time.thread_time()
    loop.run(6.0, each)
    share = (time.thread_time() - cpu) / (time.perf_counter() - began)
    gc.enable()
    gc.unfreeze()
    return loop.tick_times, share, spent


def stopwatch(function: Callable[..., object], times: list[float]) -> Callable[..., object]:
    """The function, which notes how long it took [s]."""

    def watched(*args: object) -> object:
        began = time.perf_counter()
        result = function(*args)
        times.append(time.perf_counter() - began)
        return result

    return watched


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
