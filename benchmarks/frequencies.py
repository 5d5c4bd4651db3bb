"""Natural frequency of the DCM, constant and varying, on the flat and over stairs. A table for ``control.py``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from benchmarks import walks
from harness.closed_loop import ClosedLoop, load_robot
from valor.robot.legs import knees
from valor.simulation import worlds
from valor.simulation.worlds.courses import Stairs
from valor.whole_body.walking.footsteps import StepQueue
from valor.whole_body.walking.velocity_steps import VelocitySteps

WORDS = ("constant", "varying")  # of natural_frequency
SPEEDS, SECONDS = (0.5, 0.8), 10.0  # on the flat [m/s, s]
WINDOW = 0.02  # over which the vertical force changes [s]
HEADINGS = (
    "good",
    "time [s]",
    "DCM error RMS x, y, z [mm]",
    "largest in the plane, in height [mm]",
    "vertical force, least, largest [% of weight]",
    "its rate, RMS [kN/s]",
    "largest torque [% of limit]",
    "torques at their limit",
    "knee torque, RMS [N·m]",
    "least knee [rad]",
    "QP failures",
    "tick p50, largest [µs]",
)


class Run(NamedTuple):
    """Outcome of a run; (k, …) for each period."""

    fall: str | None
    time: float  # [s]
    errors: np.ndarray  # (k, 3) [m]
    force: np.ndarray  # (k,) vertical, felt by both feet, over its mean
    weight: float  # that mean [N]
    efforts: np.ndarray  # (k, n) over the limits
    knee: np.ndarray  # (k, 2) torques [N·m]
    flexion: float  # least [rad]
    qp_failures: int
    ticks: np.ndarray  # [s]
    period: float  # [s]


def table(name: str, profile: str, seeds: int) -> Iterator[str]:
    """Two rows for each run; means over the seeds that stood at the end, extremes and failures of all."""
    yield f"\n## Natural frequency, {name}, {profile}\n"
    columns = ("run", "ω", *HEADINGS)
    yield f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}"
    stairs = [(flight, flight, 0.0) for flight, world in worlds.WORLDS.items() if isinstance(world, Stairs)]
    for what, world, speed in (*stairs, *((f"flat, {speed} m/s", "flat", speed) for speed in SPEEDS)):
        for word in WORDS:
            robot = load_robot(name, whole_body={"natural_frequency": word})
            runs = [run(walks.standing_in(robot, profile, seed, world), world, speed) for seed in range(seeds)]
            yield f"| {what} | {word} | {cells(runs)} |"


def run(loop: ClosedLoop, world: str, speed: float) -> Run:
    """Walk at a speed and stop, or climb up and down by plan."""
    robot, until = loop.robot, loop.time + SECONDS
    walking, queue, flight = VelocitySteps(robot.tables.walking), StepQueue(), worlds.WORLDS[world]
    if isinstance(flight, Stairs):
        queue.begin(walks.as_steps(robot, walks.over_stairs(robot.tables, flight)))
    loop.request.steps = walking if speed else queue

    def going() -> bool:
        if loop.time < until:
            walking.command(np.array((speed, 0.0, 0.0)), loop.time)
        walking.advance(loop.time)
        return loop.time < until or not loop.controller.at_rest if speed else queue.running

    began, bent, errors, forces, efforts, flexion = loop.time, knees(robot), [], [], [], np.inf
    loop.tick_times.clear()
    while loop.fall is None and going():
        loop.step()
        errors.append(loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom)
        forces.append(float(loop.state.foot_forces.sum()))
        efforts.append(loop.command.effort)
        flexion = min(flexion, float(bent.flexion(loop.plant.joint_position).min()))
    weight, torques = float(np.mean(forces)), np.array(efforts)
    return Run(
        loop.fall, loop.time - began, np.array(errors), np.array(forces) / weight, weight,
        np.abs(torques) / robot.effort_limit, torques[:, bent.indices], flexion,
        loop.command.qp_failures, np.array(loop.tick_times), robot.control_period,
    )  # fmt: skip


def cells(runs: list[Run]) -> str:
    """The cells of ``HEADINGS``."""
    good = [each for each in runs if each.fall is None] or runs

    def mean(values: list[float]) -> float:
        return float(np.mean(values))

    x, y, z = 1e3 * np.mean([np.sqrt(np.mean(each.errors**2, axis=0)) for each in good], axis=0)
    across = 1e3 * max(float(np.hypot(*each.errors.T[:2]).max()) for each in good)
    up = 1e3 * max(float(np.abs(each.errors[:, 2]).max()) for each in good)
    low, high = (100 * mean([float(np.percentile(each.force, q)) for each in good]) for q in (0.5, 99.5))
    window = round(WINDOW / good[0].period)
    rates = [float(np.std(each.force[window:] - each.force[:-window])) * each.weight / WINDOW / 1e3 for each in good]
    ticks = 1e6 * np.concatenate([each.ticks for each in good])
    return (
        f"{len([each for each in runs if each.fall is None])}/{len(runs)} | {mean([each.time for each in good]):.1f} "
        f"| {x:.1f}, {y:.1f}, {z:.1f} | {across:.0f}, {up:.0f} | {low:.0f}, {high:.0f} | {mean(rates):.2f} "
        f"| {100 * max(float(each.efforts.max()) for each in good):.0f} "
        f"| {sum(int(np.count_nonzero(each.efforts >= 0.999)) for each in good)} "
        f"| {mean([float(np.sqrt(np.mean(each.knee**2))) for each in good]):.1f} "
        f"| {min(each.flexion for each in good):.2f} | {sum(each.qp_failures for each in runs)} "
        f"| {np.median(ticks):.0f}, {ticks.max():.0f}"
    )
