"""A door opened and a valve turned: plant and Motion Manager in one process, truth from the simulator.

``python -m benchmarks.task [door|valve…] [--starts N] [--first SEED] [--profile NAME…] [--compensation on off]`` prints
a table; ``--starts 2`` is quick. It walks to a stance by footsteps; its right hand goes where ``valor.manipulation``
says, by what was seen from the start (``seen.py`` there: 1 cm, 0.02 rad off). A seed draws where
the fixture stands. *Done* is a door that has been opened by 10°, a wheel that has been turned by 360°, and no fall.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence

import numpy as np

from harness.closed_loop import load_robot
from harness.task_robot import Outcome, TaskRobot
from valor.manipulation.known import TASKS

COLUMNS = ("task", "actuators", "compensation", "done", "turned, least and median [°]", "falls", "time, median [s]")


def outcomes(task: str, profile: str, seeds: Sequence[int], *, compensation: bool, name: str) -> list[Outcome]:
    """Of every start; each is told on standard error."""
    robot = load_robot(name, arm_servos={"compensation": compensation})
    made = list[Outcome]()
    for seed in seeds:
        outcome = TaskRobot(robot, profile, seed, task).do()
        word = "done" if outcome.done else f"not done {outcome.reason}"
        told = f"{word}, {math.degrees(outcome.turned):.1f}°, {outcome.time:.1f} s"
        start = f"{task}, {profile}, {'on' if compensation else 'off'}, start {seed}"
        print(f"{start}: {told}", file=sys.stderr, flush=True)
        made.append(outcome)
    return made


def table(arguments: argparse.Namespace) -> Iterator[str]:
    """Rows."""
    yield f"| {' | '.join(COLUMNS)} |"
    yield "|---|---|---|---|---|---|---|"
    seeds = range(arguments.first, arguments.first + arguments.starts)
    for task in arguments.tasks or TASKS:
        for profile in arguments.profile:
            for compensation in arguments.compensation:
                made = outcomes(task, profile, seeds, compensation=compensation == "on", name=arguments.robot)
                turned = np.degrees([each.turned for each in made])
                cells = (
                    task, profile, compensation, f"{sum(each.done for each in made)} of {len(made)}",
                    f"{turned.min():.0f}, {np.median(turned):.0f}", str(sum(each.fell for each in made)),
                    f"{np.median([each.time for each in made]):.0f}",
                )  # fmt: skip
                yield f"| {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", choices=[*TASKS, []])
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--profile", nargs="+", default=["hardware", "hdt_arms"])
    parser.add_argument("--compensation", nargs="+", choices=("on", "off"), default=["on", "off"])
    parser.add_argument("--robot", default="escher")
    for row in table(parser.parse_args()):
        print(row, flush=True)


if __name__ == "__main__":
    main()
