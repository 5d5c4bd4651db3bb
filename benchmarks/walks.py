"""Walks in process, and what came of them: on the flat by velocity, over dirt and rubble, over stairs by plan."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Literal

import numpy as np

from harness.closed_loop import ClosedLoop, load_robot
from valor.common import rotation
from valor.control.steps import Step
from valor.robot.description import RobotDescription
from valor.robot.legs import knees
from valor.robot.step_plan import FEET, PlanStep
from valor.robot.tables import RobotTables
from valor.simulation import worlds
from valor.simulation.worlds.courses import Stairs
from valor.whole_body.walking.footsteps import StepQueue, level_pose
from valor.whole_body.walking.velocity_steps import VelocitySteps

SWING_HEIGHT = 0.08  # between steps of stairs [m]
STEP_DURATION, SWAY_DURATION = 1.0, 0.4  # there [s]
LENGTH = 0.3  # of steps on the landing, about [m]
DOWN = 0.03  # further than the middle of a tread, so that the heel clears the edge [m]
BEFORE, RUN_UP = 0.03, 0.16  # of the toes to the first riser, and the step before it [m]
WALKS = (  # [m/s, rad/s]
    (0.3, 0, 0), (0.5, 0, 0), (0.8, 0, 0), (1.2, 0, 0), (-0.2, 0, 0),
    (0, 0.1, 0), (0, 0.4, 0), (0, 0, 0.8), (0.3, 0, 0.3),
)  # fmt: skip
WALK_DURATION = 20.0  # [s]
COURSES = (("dirt", 0.45, 61.0), ("dirt", 0.8, 61.0), ("rubble", 0.4, 4.0))  # speed [m/s], way [m]


HEADINGS = (
    "way of the pelvis [m]",
    "time [s]",
    "odometry's error [m]",
    "DCM error RMS x, y, z [mm]",
    "smallest knee angle [rad]",
    "torques at their limit",
    "QP's foot forces − felt, RMS [N]",
    "QP failures",
    "tick p50, p99 [µs]",
    "fall",
)


def heading(*first: str) -> str:
    """Of a table of walks."""
    columns = (*first, *HEADINGS)
    return f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}"


def walking(name: str, profile: str, seeds: int) -> Iterator[str]:
    """Walks of a robot from rest and back to rest."""
    robot = load_robot(name)
    yield f"\n## Walking {WALK_DURATION:.0f} s and stopping, {profile}\n"
    yield heading("velocity x, y, turn [m/s, rad/s]", "seed")
    for velocity in WALKS:
        for seed in range(seeds):
            yield f"| {', '.join(map(str, velocity))} | {seed} | {walk(robot, profile, seed, velocity)} |"


def courses(name: str, profile: str, seeds: int) -> Iterator[str]:
    """Ground that nobody told the controller about, by velocity, and stairs by plan, up and down again."""
    robot = load_robot(name)
    yield f"\n## Courses, {profile}\n"
    yield heading("world", "seed")
    for course, speed, way in COURSES:
        for seed in range(seeds):
            loop = standing_in(robot, profile, seed, course)
            yield f"| {course}, {speed} m/s | {seed} | {follow(loop, speed, way)} |"
    for flight, world in worlds.WORLDS.items():
        if isinstance(world, Stairs):
            for seed in range(seeds):
                loop = standing_in(robot, profile, seed, flight)
                yield f"| {flight} | {seed} | {climb(loop, world)} |"


def walk(robot: RobotDescription, profile: str, seed: int, velocity: tuple[float, float, float]) -> str:
    """One walk on the flat, as the cells of its row."""
    loop = standing_in(robot, profile, seed, "flat")
    source = loop.request.steps = VelocitySteps(robot.tables.walking)
    until = loop.time + WALK_DURATION

    def going() -> bool:
        if loop.time < until:
            source.command(np.array(velocity), loop.time)
        source.advance(loop.time)
        return loop.time < until or not loop.controller.at_rest

    return measure(loop, going)


def follow(loop: ClosedLoop, speed: float, way: float) -> str:
    """A way straight ahead at a speed, kept to by odometry, as the cells of its row."""
    source = loop.request.steps = VelocitySteps(loop.robot.tables.walking)

    def going() -> bool:
        state = loop.state
        x, y, _ = state.pelvis_position_in_odom.tolist()
        if x < way:
            turn = -0.6 * rotation.yaw(state.pelvis_rotation_in_odom) - 0.3 * y
            source.command(np.array((speed, 0.0, min(0.2, max(-0.2, turn)))), loop.time)
        source.advance(loop.time)
        return x < way or not loop.controller.at_rest

    return measure(loop, going)


def climb(loop: ClosedLoop, stairs: Stairs) -> str:
    """A flight of stairs up and down by plan, as the cells of its row."""
    queue = loop.request.steps = StepQueue()
    queue.begin(as_steps(loop.robot, over_stairs(loop.robot.tables, stairs)))
    return measure(loop, lambda: queue.running)


def as_steps(robot: RobotDescription, plan: Sequence[PlanStep]) -> list[Step]:
    """A plan as the gait takes it, with the robot's own figures where the plan has none."""
    table = robot.tables.walking
    return [
        Step(
            index=i,
            foot=FEET.index(step.foot),
            sole=level_pose(step.x, step.y, step.z, step.yaw),
            swing_height=step.swing_height or table.plan_swing_height,
            swing_duration=step.step_duration or table.swing_duration,
            transfer_duration=step.sway_duration or table.transfer_duration,
        )
        for i, step in enumerate(plan)
    ]


def standing_in(robot: RobotDescription, profile: str, seed: int, world: str) -> ClosedLoop:
    """The robot in a world, standing at rest."""
    loop = ClosedLoop(robot, profile, seed, world=world)
    loop.settle(0.3)
    loop.run(2.2)
    return loop


def measure(loop: ClosedLoop, going: Callable[[], bool]) -> str:
    """Step for as long as it goes on and nobody falls; what came of it, as the cells of ``HEADINGS``."""
    robot = loop.robot
    bent = knees(robot)
    before, believed, began = loop.plant.data.qpos[:3].copy(), loop.state.pelvis_position_in_odom, loop.time
    errors, forces, knee, limited = [], [], np.inf, 0
    loop.tick_times.clear()
    while loop.fall is None and going():
        loop.step()
        errors.append(loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom)
        forces.append(loop.command.desired_foot_forces - loop.state.foot_forces)
        knee = min(knee, float(bent.flexion(loop.plant.joint_position).min()))
        limited += int(np.count_nonzero(np.abs(loop.command.effort) >= 0.999 * robot.effort_limit))
    x, y, z = np.sqrt(np.mean(np.square(errors), axis=0)) * 1e3
    way = loop.plant.data.qpos[:3] - before
    off = float(np.linalg.norm(loop.state.pelvis_position_in_odom - believed - way))
    p50, p99 = np.percentile(loop.tick_times, (50, 99)) * 1e6
    return (
        f"{np.linalg.norm(way[:2]):.2f} | {loop.time - began:.1f} | {off:.3f} | {x:.1f}, {y:.1f}, {z:.1f} | {knee:.2f} "
        f"| {limited} | {np.sqrt(np.mean(np.square(forces))):.0f} | {loop.command.qp_failures} "
        f"| {p50:.0f}, {p99:.0f} | {loop.fall or '–'}"
    )


def over_stairs(tables: RobotTables, stairs: Stairs) -> list[PlanStep]:
    """One foot on each step, in its middle, going down a little further; feet together at the end. In odom."""
    table, foot = tables.walking, tables.feet.left
    middle = 0.5 * stairs.tread - 0.5 * (foot.heel + foot.toe)
    top = stairs.rise * stairs.steps
    first, last = stairs.up[-1] + middle, stairs.down[0] - foot.toe - 0.025  # on the landing
    level = max(2, round((last - first) / LENGTH))
    places = [(stairs.up[0] - foot.toe - BEFORE - x, 0.0) for x in (RUN_UP, 0.0)]
    places += [(x + middle, stairs.rise * (i + 1)) for i, x in enumerate(stairs.up)]
    places += [(first + (last - first) * (i + 1) / level, top) for i in range(level)]
    places += [(x + middle + DOWN, top - stairs.rise * (i + 1)) for i, x in enumerate(stairs.down)]
    places.append(places[-1])
    steps, height = [], 0.0
    for i, (x, z) in enumerate(places):
        slow = abs(z - height) > 0.0 or i == len(places) - 1
        lift, swing, sway = (SWING_HEIGHT, STEP_DURATION, SWAY_DURATION) if slow else (0.0, 0.0, 0.0)
        y = table.step_width * (0.5 - i % 2)
        side: Literal["left", "right"] = "right" if i % 2 else "left"
        steps.append(PlanStep(foot=side, x=x, y=y, z=z, swing_height=lift, step_duration=swing, sway_duration=sway))
        height = z
    return steps
