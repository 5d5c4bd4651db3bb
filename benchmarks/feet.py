"""Robots with force/torque sensors in the feet and without: the same tests, and how well each keeps its DCM."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from msgspec import structs

from harness.closed_loop import load_robot
from harness.foot_sensors import with_foot_sensors
from harness.strangers import ROBOTS
from valor.robot.description import RobotDescription
from valor.robot.step_plan import FEET, PlanStep
from valor.robot_setup.new import new_robot
from valor.self_test.acceptance import DIRECTIONS as PUSHES
from valor.self_test.closed_loop import MeasuredLoop, leg_length
from valor.self_test.plan_walk import take_plan
from valor.whole_body.walking.velocity_steps import VelocitySteps

IMPULSE, SPEED = 0.4, 0.3  # of a push by mass [N·s/kg], of a walk [m/s]
STAND, RECOVERY, WALK = 4.0, 2.0, 6.0  # [s]
DIRECTIONS = {name: PUSHES[name] for name in ("forward", "left")}
STRIDE = 0.23  # of a planned step, by the leg's length
SENSORS = ("feet, accelerometer", "accelerometer", "neither")


def table(names: Sequence[str], profile: str, seeds: int) -> Iterator[str]:
    """Each robot with fewer and fewer sensors: DCM error of each test, RMS of its worst axis [mm], or why it fell."""
    yield f"\n## Robots without sensors in their feet, {profile}\n"
    pushes = " | ".join(f"push {direction}" for direction in DIRECTIONS)
    yield f"| robot | sensors | seed | stand | {pushes} | six steps | walk {SPEED} m/s |"
    yield f"|{'---|' * (6 + len(DIRECTIONS))}"
    for name in names:
        bare = load(name)
        for sensors in SENSORS:
            robot = equipped(bare, sensors)
            for seed in range(seeds):
                yield f"| {name} | {sensors} | {seed} | {' | '.join(tested(robot, profile, seed))} |"


def load(name: str) -> RobotDescription:
    """A robot of ours, or made from a maker's file."""
    if name not in ROBOTS:
        return load_robot(name)
    folder = Path(tempfile.mkdtemp()) / name
    new_robot(ROBOTS[name].model(), folder, name)
    return RobotDescription.load(folder)


def equipped(robot: RobotDescription, sensors: str) -> RobotDescription:
    """The robot with one of ``SENSORS``."""
    robot = with_foot_sensors(robot, "feet" in sensors)
    imu = structs.replace(robot.tables.imu, accelerometer="accelerometer" in sensors)
    return RobotDescription(robot.folder, structs.replace(robot.tables, imu=imu))


def tested(robot: RobotDescription, profile: str, seed: int) -> Iterator[str]:
    """The cells of a row."""
    loop = standing(robot, profile, seed)
    loop.run(STAND)
    yield cell(loop)
    for direction in DIRECTIONS.values():
        loop = standing(robot, profile, seed)
        loop.plant.push(IMPULSE * float(loop.plant.model.mj.body_mass.sum()) * np.array(direction), 0.1)
        while loop.fall is None and loop.time < 2.3 + RECOVERY:
            loop.step()
        yield cell(loop)
    loop, half, stride = standing(robot, profile, seed), robot.tables.walking.step_width / 2, STRIDE * leg_length(robot)
    places = ((stride * min(i, 5), half if i % 2 else -half) for i in range(1, 7))
    walked = take_plan(loop, [PlanStep(foot=FEET[1 - i % 2], x=x, y=y) for i, (x, y) in enumerate(places, 1)])
    yield walked.refusal or cell(loop)
    loop = standing(robot, profile, seed)
    source = loop.request.steps = VelocitySteps(robot.tables.walking)
    while loop.fall is None and (loop.time < 2.3 + WALK or not loop.controller.at_rest):
        if loop.time < 2.3 + WALK:
            source.command(np.array((SPEED, 0.0, 0.0)), loop.time)
        source.advance(loop.time)
        loop.step()
    yield cell(loop)


def standing(robot: RobotDescription, profile: str, seed: int) -> MeasuredLoop:
    """The robot at rest, whose measurements begin."""
    loop = MeasuredLoop(robot, profile, seed)
    loop.settle(0.3)
    loop.run(2.0)
    loop.begin()
    return loop


def cell(loop: MeasuredLoop) -> str:
    """Outcome of a test."""
    error = loop.measurements().dcm_error or 0.0
    return f"{loop.fall or ''} {1e3 * error:.1f}".strip()
