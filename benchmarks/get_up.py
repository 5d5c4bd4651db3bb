"""Falls to every side and ways up again: plant and Motion Manager in one process, hardware's errors.

``python -m benchmarks.get_up [--robot NAME] [--from WAY] [--seeds N] [--profile NAME]`` prints a table.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

from harness.places import ROBOTS
from harness.robot_in_process import RobotInProcess
from valor.robot.description import RobotDescription
from valor.robot.get_up_table import Posture

WAYS = [way for way in Posture if way is not Posture.STANDING]


def main() -> None:
    """Print the table: each fall starts from a random posture of the arms, towards a way of lying."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="escher", help="a name, or a folder")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--profile", default="hardware")
    parser.add_argument("--from", dest="ways", choices=WAYS, action="append")
    arguments = parser.parse_args()
    folder = ROBOTS / arguments.robot
    robot = RobotDescription.load(folder if folder.is_dir() else Path(arguments.robot))
    print("| robot | fallen towards | up | Get Up [s], mean and longest | largest share of a torque limit | else |")
    print("|---|---|---|---|---|---|", flush=True)
    for way in arguments.ways or WAYS:
        times, failures, peak = list[float](), Counter[str](), 0.0
        for seed in range(arguments.first, arguments.first + arguments.seeds):
            run = RobotInProcess(robot, arguments.profile, seed)
            run.topple(Posture(way), seed)
            began = run.time
            if failure := run.get_up():
                failures[failure] += 1
            else:
                times.append(run.time - began)
            peak = max(peak, float((run.peak / robot.effort_limit).max()))
        took = f"{sum(times) / len(times):.1f}, {max(times):.1f}" if times else ""
        worst = "; ".join(f"{count} × {reason}" for reason, count in failures.items())
        cells = (robot.name, way, f"{len(times)} of {arguments.seeds}", took, f"{peak:.2f}", worst)
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
