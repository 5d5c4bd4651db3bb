"""Falls after a push: what hits the ground, and how hard, with the landing and going limp at once.

The simulator's truth: the largest force of the ground on the head, on both hands and forearms and on the trunk, in any
physics step; and the robot's kinetic energy when anything but a foot first touches the ground. A robot without a body
for its head has it in its chest, above the shoulders.

    .venv/bin/python -m benchmarks.falls [--robot NAME] [--seeds 5] [--impulse 1.3] [--direction NAME] [--each]
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the services run; NumPy reads it once

import mujoco
import numpy as np

from harness.closed_loop import load_robot
from harness.robot_in_process import RobotInProcess
from valor.common.behaviors import Behavior
from valor.motion_manager.locomotion.landing import Landing
from valor.robot.description import RobotDescription
from valor.robot.tables import WHOLE_BODY_GROUPS

IMPULSE = 1.3  # by mass [N·s/kg]
DIRECTIONS = {"forward": 0.0, "backward": 180.0, "left": 90.0, "forward and left": 45.0}  # [°]
LASTS = 2.5  # from the push [s]
ABOVE = 0.08  # lowest point of a head in the chest above the shoulders [m]
PARTS = ("head", "hands", "trunk")


class Impact(NamedTuple):
    """Outcome of a fall."""

    forces: np.ndarray  # (3,) largest on ``PARTS`` [N]
    energy: float  # kinetic, at the first contact [J]
    warning: float  # from the detection to that contact [s]
    excess: float  # largest excess of a joint over its limits [rad]
    lies: str  # behavior in the end, and the attitude [°]


def fall(run: RobotInProcess, heading: float, impulse: float, lands: bool) -> Impact:
    """Push a standing robot over: heading, 90 is left [°], impulse by mass [N·s/kg]; ``lands``: False to go limp."""
    plant, robot = run.plant, run.plant.model.robot
    mj, data = plant.model.mj, plant.data
    groups = parts(plant.model.mj, robot)
    chest, shoulder = data.body(robot.tables.chest), data.joint(robot.tables.group("left_arm")[0])
    neck = np.inf if robot.tables.head else float((shoulder.xanchor - chest.xpos) @ chest.xmat[2::3]) + ABOVE
    feet = [plant.model.body(foot.body) for foot in (robot.tables.feet.left, robot.tables.feet.right)]
    moved = np.concatenate([robot.group_indices(group) for group in WHOLE_BODY_GROUPS])  # not fingers
    forces, force = np.zeros(3), np.zeros(6)
    energy = touched = detected = outside = 0.0
    if not lands:
        Landing.begin = lambda *_: None  # type: ignore[method-assign]
    mass = float(mj.body_mass.sum())
    plant.push(impulse * mass * np.array((np.cos(np.radians(heading)), np.sin(np.radians(heading)), 0.0)), 0.1)
    step = plant.step

    def watched(count: int) -> None:
        nonlocal energy, touched, forces
        for _ in range(count):
            step(1)
            now = np.zeros(3)
            for row in range(data.ncon):
                bodies = mj.geom_bodyid[data.contact[row].geom]
                if 0 not in mj.body_weldid[bodies]:
                    continue  # of the robot with itself
                body = int(bodies.max())
                mujoco.mj_contactForce(mj, data, row, force)
                head = body == chest.id and (data.contact[row].pos - chest.xpos) @ chest.xmat[2::3] > neck
                now[[0] if head else groups[body]] += np.linalg.norm(force[:3])
                if not touched and body not in feet and force[0] > 1.0:
                    touched = data.time
                    mujoco.mj_energyVel(mj, data)
                    energy = float(data.energy[1])
            forces = np.maximum(forces, now)

    plant.step = watched  # type: ignore[method-assign]
    until = run.time + LASTS
    while run.time < until:
        run.step()
        detected = detected or (data.time if run.behavior is Behavior.FALL else 0.0)
        excess = np.maximum(plant.joint_position - robot.upper, robot.lower - plant.joint_position)
        outside = max(outside, float(excess[moved].max()))
    w, x, y, z = data.qpos[3:7]
    pitch = np.degrees(np.arcsin(np.clip(2 * (w * y - x * z), -1, 1)))
    return Impact(forces, energy, touched - detected, outside, f"{run.behavior}, pitch {pitch:.0f}°")


def parts(mj: mujoco.MjModel, robot: RobotDescription) -> list[list[int]]:
    """Indices of ``PARTS`` that each body belongs to: none, or one."""
    tables = robot.tables
    found: list[list[int]] = [[] for _ in range(mj.nbody)]
    arms = {int(mj.joint(name).bodyid[0]) for arm in ("left_arm", "right_arm") for name in tables.group(arm)[3:]}
    for body in range(mj.nbody):
        above, top = body, body
        while above and above not in arms:
            above = int(mj.body_parentid[above])
        while top and mj.body(top).name != tables.head:
            top = int(mj.body_parentid[top])
        trunk = mj.body(body).name in (tables.chest, tables.base)
        found[body] = [1] if above else [0] if top else [2] if trunk else []
    return found


def falls(robot: RobotDescription, seed: int, options: argparse.Namespace) -> dict[str, list[Impact]]:
    """Impacts by direction, limp and landing: each in a copy of the process, from the same robot, standing."""
    run = RobotInProcess(robot, options.profile, seed)
    assert not (refused := run.stand_up()), refused
    run.run(0.5)
    results: dict[str, list[Impact]] = {}
    for direction in options.direction:
        results[direction] = []
        for lands in (False, True):
            pipe, end = multiprocessing.Pipe()
            heading = float(DIRECTIONS.get(direction, direction))
            child = multiprocessing.get_context("fork").Process(
                target=lambda end=end, heading=heading, lands=lands: end.send(
                    fall(run, heading, options.impulse, lands)
                )
            )
            child.start()
            results[direction].append(pipe.recv())
            child.join()
    return results


def table(options: argparse.Namespace) -> Iterator[str]:
    """Medians over the seeds, limp → landing."""
    robot = load_robot(options.robot)
    pushed = f"{options.profile}, {options.impulse} N·s/kg, {options.seeds} seeds"
    yield f"\n## Falls, {robot.name}, {pushed}: limp → landing\n"
    heads = " | ".join(f"{part} [N]" for part in PARTS)
    yield f"| pushed | {heads} | energy at the first contact [J] | warning [s] | outside limits [rad] | lies |"
    yield f"|{'---|' * 8}"
    found = [falls(robot, seed, options) for seed in range(options.seeds)]
    for direction in options.direction:
        pairs = [result[direction] for result in found]
        for rows in [[pair] for pair in pairs] * options.each + [pairs]:
            limp, landing = zip(*rows, strict=True)
            yield f"| {direction} | {' | '.join(cells(limp, landing))} |"


def cells(limp: Sequence[Impact], landing: Sequence[Impact]) -> Iterator[str]:
    """The cells of a row."""
    for i in range(len(PARTS)):
        yield change([one.forces[i] for one in limp], [one.forces[i] for one in landing])
    yield change([one.energy for one in limp], [one.energy for one in landing])
    yield f"{np.median([one.warning for one in landing]):.2f}"
    yield f"{max(one.excess for one in limp):.2f} → {max(one.excess for one in landing):.2f}"
    yield ", ".join(dict.fromkeys(one.lies for one in landing))


def change(before: Sequence[float], after: Sequence[float]) -> str:
    """Two medians, and by how much the second is larger."""
    first, second = float(np.median(before)), float(np.median(after))
    return f"{first:.0f} → {second:.0f}" + (f" ({100 * (second / first - 1):+.0f} %)" if first > 1.0 else "")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="escher")
    parser.add_argument("--profile", default="hardware")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--impulse", type=float, default=IMPULSE, help="by mass [N·s/kg]")
    parser.add_argument("--direction", action="append", help=f"{', '.join(DIRECTIONS)}, or a heading, 90 is left [°]")
    parser.add_argument("--each", action="store_true", help="a row for each seed, too")
    options = parser.parse_args()
    options.direction = options.direction or list(DIRECTIONS)
    for line in table(options):
        print(line, flush=True)


if __name__ == "__main__":
    main()
