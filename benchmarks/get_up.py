"""Falls by a push and ways up again: plant and Motion Manager in one process, hardware's errors.

``python -m benchmarks.get_up [--seeds N] [--profile NAME]`` prints a table.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from harness.closed_loop import load_robot
from harness.robot_in_process import RobotInProcess
from valor.robot.description import RobotDescription

PUSHES: dict[str, tuple[float, float, float]] = {
    "forward": (110.0, 0.0, 0.0),
    "forward and left": (90.0, 60.0, 0.0),
    "back": (-110.0, 0.0, 0.0),
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """Of one fall."""

    failure: str
    duration: float  # of Get Up [s]
    peak: str  # of the torque, joint with the highest share of its limit


def outcome(robot: RobotDescription, profile: str, seed: int, push: tuple[float, float, float]) -> Outcome:
    """Fall and get up."""
    run = RobotInProcess(robot, profile, seed)
    run.fall(push)
    began = run.time
    failure = run.get_up()
    duration = run.time - began
    legs = np.concatenate([robot.group_indices(group) for group in ("left_leg", "right_leg")])
    worst = legs[int(np.argmax(run.peak[legs] / robot.effort_limit[legs]))]
    peak = f"{robot.joints[worst]} {run.peak[worst]:.0f} of {robot.effort_limit[worst]:.0f}"
    return Outcome(failure or run.stand(), duration, peak)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--profile", default="hardware")
    parser.add_argument("--push", choices=PUSHES, action="append")
    arguments = parser.parse_args()
    robot = load_robot()
    print("| pushed | seed | stands again | Get Up [s] | largest torque of a leg [N·m] | else |")
    print("|---|---|---|---|---|---|")
    for name in arguments.push or PUSHES:
        for seed in range(arguments.first, arguments.first + arguments.seeds):
            result = outcome(robot, arguments.profile, seed, PUSHES[name])
            stands = "no" if result.failure else "yes"
            cells = (name, f"{seed}", stands, f"{result.duration:.1f}", result.peak, result.failure)
            print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
