"""What the Whole-Body Controller costs and achieves, plant and controller in one process.

Prints Markdown tables: the time of a tick, standing over seeds, the largest push survived in each direction against
the bound of physics m·ω·Δξ (no step taken: the DCM must stay within reach of the centre of pressure), and walking.

    .venv/bin/python benchmarks/control.py [ticks] [standing] [pushes] [walking]
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

from motion_manager.whole_body.arms import UpperBodyKinematics
from motion_manager.whole_body.dcm import DcmLaw
from motion_manager.whole_body.walking.velocity_steps import VelocitySteps
from tests.unit.whole_body.closed_loop import ClosedLoop, load_robot
from valor_common.model import controller_model
from valor_common.robot import RobotDescription

DIRECTIONS = {"forward": (1, 0), "back": (-1, 0), "left": (0, 1), "right": (0, -1)}
PUSH_DURATION = 0.1  # [s]
PUSH_RESOLUTION = 0.5  # of the bisection [N·s]
WALKS = ((0.2, 0, 0), (0.3, 0, 0), (0.4, 0, 0), (0.5, 0, 0), (-0.2, 0, 0), (0, 0.1, 0), (0.3, 0, 0.3))  # [m/s, rad/s]
WALK_DURATION = 20.0  # [s]


def main() -> None:
    """Run what the command line asks for; everything by default."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", help="ticks, standing, pushes, walking; default: all")
    parser.add_argument("--robot", default="escher")
    parser.add_argument("--profile", default="hardware")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=60.0, help="of standing, for each seed")
    options = parser.parse_args()
    robot = load_robot(options.robot)
    parts = {
        "ticks": lambda: ticks(robot, options.profile),
        "standing": lambda: standing(robot, options.profile, options.seeds, options.seconds),
        "pushes": lambda: pushes(robot, options.profile, options.seeds),
        "walking": lambda: walking(robot, options.profile, options.seeds),
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


def pushes(robot: RobotDescription, profile: str, seeds: int) -> Iterator[str]:
    """The largest push survived, by bisection, and when a push of 80 N·s is told to be a fall."""
    model = controller_model(robot)
    mass = float(model.mj.body_subtreemass[model.body(robot.tables.base)])
    omega = DcmLaw.natural_frequency(UpperBodyKinematics(model).nominal_com_height, 9.81)
    half = reach(robot)
    yield f"\n## Pushes of {PUSH_DURATION} s at the chest, feet fixed, {profile}\n"
    yield "| direction | survived, by seed [N·s] | bound m·ω·Δξ [N·s] | share | 80 N·s told after [ms] |"
    yield "|---|---|---|---|---|"
    for name, direction in DIRECTIONS.items():
        survived = [largest(robot, profile, seed, direction) for seed in range(seeds)]
        bound = mass * omega * abs(np.dot(direction, half))
        told = [push(robot, profile, seed, direction, 80.0)[1] for seed in range(seeds)]
        times = ", ".join("–" if t is None else f"{1e3 * t:.0f}" for t in told)
        impulses = ", ".join(f"{s:.1f}" for s in survived)
        yield f"| {name} | {impulses} | {bound:.1f} | {100 * np.mean(survived) / bound:.0f} % | {times} |"


def reach(robot: RobotDescription) -> tuple[float, float]:
    """How far the sole's edge is from the middle of the support, forward and sideways [m]."""
    foot = robot.tables.feet.left
    loop = ClosedLoop(robot)
    loop.step()
    apart = loop.state.sole_positions_in_odom[0, 1] - loop.state.sole_positions_in_odom[1, 1]
    return 0.5 * (foot.toe - foot.heel), 0.5 * float(apart) + foot.half_width


def largest(robot: RobotDescription, profile: str, seed: int, direction: tuple[int, int]) -> float:
    """The largest impulse survived in a direction [N·s]."""
    low, high = 0.0, 60.0
    while high - low > PUSH_RESOLUTION:
        middle = 0.5 * (low + high)
        if push(robot, profile, seed, direction, middle)[0]:
            low = middle
        else:
            high = middle
    return low


def push(
    robot: RobotDescription, profile: str, seed: int, direction: tuple[int, int], impulse: float
) -> tuple[bool, float | None]:
    """Whether the robot survived a push [N·s], and after what time it was told to fall [s]."""
    loop = ClosedLoop(robot, profile, seed)
    loop.settle(0.3)
    loop.run(2.2)
    began = loop.time
    loop.plant.push(impulse * np.array((*direction, 0.0)), PUSH_DURATION)
    while loop.fall is None and loop.time < began + 4.0:
        loop.step()
    return loop.fall is None, None if loop.fall_time is None else loop.fall_time - began


def walking(robot: RobotDescription, profile: str, seeds: int) -> Iterator[str]:
    """Walks from rest and back to rest."""
    yield f"\n## Walking {WALK_DURATION:.0f} s and stopping, {profile}\n"
    yield (
        "| velocity x, y, turn [m/s, rad/s] | seed | way of the pelvis [m] | odometry's error [m] "
        "| DCM error RMS x, y, z [mm] | smallest knee angle [rad] | torques at their limit | QP failures "
        "| tick p50, p99 [µs] | fall |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for velocity in WALKS:
        for seed in range(seeds):
            yield f"| {', '.join(map(str, velocity))} | {seed} | {walk(robot, profile, seed, velocity)} |"


def walk(robot: RobotDescription, profile: str, seed: int, velocity: tuple[float, float, float]) -> str:
    """One walk, as the cells of its row."""
    loop = ClosedLoop(robot, profile, seed)
    loop.settle(0.3)
    loop.run(2.2)
    source = loop.controller.step_source = VelocitySteps(robot.tables.walking)
    knees = [robot.index["l_knee_pitch"], robot.index["r_knee_pitch"]]
    before, believed = loop.plant.data.qpos[:3].copy(), loop.state.pelvis_position_in_odom
    errors, knee, limited, until = [], np.inf, 0, loop.time + WALK_DURATION
    loop.tick_times.clear()
    while loop.fall is None and (loop.time < until or loop.controller.stepping):
        if loop.time < until:
            source.command(np.array(velocity), loop.time)
        source.advance(loop.time)
        loop.step()
        errors.append(loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom)
        knee = min(knee, float(loop.plant.joint_position[knees].min()))
        limited += int(np.count_nonzero(np.abs(loop.command.effort) >= 0.999 * robot.effort_limit))
    x, y, z = np.sqrt(np.mean(np.square(errors), axis=0)) * 1e3
    way = loop.plant.data.qpos[:3] - before
    off = float(np.linalg.norm(loop.state.pelvis_position_in_odom - believed - way))
    p50, p99 = np.percentile(loop.tick_times, (50, 99)) * 1e6
    return (
        f"{np.linalg.norm(way[:2]):.2f} | {off:.3f} | {x:.1f}, {y:.1f}, {z:.1f} | {knee:.2f} | {limited} "
        f"| {loop.command.qp_failures} | {p50:.0f}, {p99:.0f} | {loop.fall or '–'}"
    )


if __name__ == "__main__":
    main()
