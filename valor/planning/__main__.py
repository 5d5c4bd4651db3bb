"""``python -m valor.planning ROBOT``: the robot's ``get_up.yaml`` made from its ``get_up_plan.yaml``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from valor.common.errors import ConfigurationError, ValorError
from valor.common.table import read
from valor.planning import plan_table, table
from valor.planning.check import check
from valor.planning.key_poses import KeyPose, find, posture_of
from valor.planning.posture import BASE
from valor.robot.description import RobotDescription
from valor.robot.model import full_model


def main() -> int:
    """Plan, say what was found, write. 1: nothing was written, and why."""
    parser = argparse.ArgumentParser(prog="python -m valor.planning", description=__doc__)
    parser.add_argument("robot", type=Path, help=f"a robot's folder, with {plan_table.FILE}")
    parser.add_argument("--dry-run", action="store_true", help="write nothing")
    arguments = parser.parse_args()
    try:
        found, content = plan(arguments.robot)
    except ValorError as error:
        print(f"valor.planning: {error}", file=sys.stderr)
        return 1
    print(content if arguments.dry_run else f"{len(found)} poses found")
    if not arguments.dry_run:
        (arguments.robot / table.FILE).write_text(content)
        print(f"written: {arguments.robot / table.FILE}")
    return 0


def plan(folder: Path) -> tuple[list[KeyPose], str]:
    """Poses found, and the content of ``get_up.yaml``; a line for each pose goes to standard error.

    Raises:
        ValorError: a file is wrong, or there are no such poses.
    """
    robot = RobotDescription.load(folder)
    if not (folder / plan_table.FILE).is_file():
        raise ConfigurationError(f"{folder / plan_table.FILE}: no such file; expected what {robot.name} stands on")
    wanted = read(plan_table.GetUpPlan, folder / plan_table.FILE)
    posture = posture_of(full_model(robot, "collision"), wanted)
    found = find(posture, wanted)
    for pose in found:
        seen = check(posture, wanted.contacts, pose)
        carried = ", ".join(f"{name} {forces[:, 2].sum():.0f}" for name, forces in pose.forces.items())
        collisions = "".join(f"; {a} in {b}" for a, b in seen.collisions)
        print(
            f"{pose.plan.name}: pitch {np.degrees(pose.coordinates[BASE - 1]):.0f}°, torque {seen.torque:.0%}, "
            f"unbalanced {np.abs(seen.unbalanced).max():.1e}, carried by {carried} N{collisions}",
            file=sys.stderr,
        )
    return found, table.text(posture, wanted, found)


if __name__ == "__main__":
    sys.exit(main())
