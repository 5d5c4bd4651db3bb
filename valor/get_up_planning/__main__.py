"""``python -m valor.get_up_planning ROBOT``: make the robot's ``get_up.yaml`` from its ``get_up_plan.yaml``."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from valor.common.errors import ConfigurationError, ValorError
from valor.common.table import read
from valor.get_up_planning.key_poses import PLAN_FILE, GetUpPlan, KeyPose, check, find, posture_of
from valor.get_up_planning.posture import BASE, SagittalPosture
from valor.robot import get_up_table
from valor.robot.description import RobotDescription
from valor.robot.model import full_model

_HEAD = """\
# Get Up of {robot}: motions of key poses, executed by the joints' servos (motion_manager/locomotion/get_up.py).
# The motion from the face: from get_up_plan.yaml by `python -m valor.get_up_planning robots/{robot}`; edit that file.
# Duration and hold [s]; joints [rad], others stay; pitch range of the pelvis afterwards
# [deg]; outside it Get Up is abandoned.
"""
_COLUMNS = 6  # joints per line


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m valor.get_up_planning", description=__doc__)
    parser.add_argument("robot", type=Path, help=f"a robot's folder, with {PLAN_FILE}")
    parser.add_argument("--dry-run", action="store_true", help="write nothing")
    arguments = parser.parse_args()
    try:
        found, content = plan(arguments.robot)
    except ValorError as error:
        print(f"valor.get_up_planning: {error}", file=sys.stderr)
        return 1
    print(content if arguments.dry_run else f"{len(found)} poses found")
    if not arguments.dry_run:
        (arguments.robot / get_up_table.FILE).write_text(content)
        print(f"written: {arguments.robot / get_up_table.FILE}")
    return 0


def plan(folder: Path) -> tuple[list[KeyPose], str]:
    """Return the solved poses and the content of ``get_up.yaml``; print a line for each to standard error."""
    robot = RobotDescription.load(folder)
    if not (folder / PLAN_FILE).is_file():
        raise ConfigurationError(f"{folder / PLAN_FILE}: no such file; expected the contacts and poses of {robot.name}")
    specified = read(GetUpPlan, folder / PLAN_FILE)
    posture = posture_of(full_model(robot, "collision"), specified)
    found = find(posture, specified)
    for pose in found:
        verified = check(posture, specified.contacts, pose)
        carried = ", ".join(f"{name} {forces[:, 2].sum():.0f}" for name, forces in pose.forces.items())
        collisions = "".join(f"; {a} in {b}" for a, b in verified.collisions)
        print(
            f"{pose.plan.name}: pitch {np.degrees(pose.coordinates[BASE - 1]):.0f}°, torque {verified.torque:.0%}, "
            f"unbalanced {np.abs(verified.unbalanced).max():.1e}, carried by {carried} N{collisions}",
            file=sys.stderr,
        )
    _, *others = (
        (folder / get_up_table.FILE).read_text().split("  - from: ") if (folder / get_up_table.FILE).is_file() else [""]
    )
    kept = "".join(f"  - from: {other}" for other in others if not other.startswith("[face]"))
    return found, text(posture, specified, found) + kept


def text(posture: SagittalPosture, plan: GetUpPlan, found: Sequence[KeyPose]) -> str:
    """Return the content of ``get_up.yaml``; a pose names the joints that it moves."""
    robot = posture.model.robot
    solved = {pose.plan.name: dict(zip(posture.joints, pose.coordinates[3:].tolist(), strict=True)) for pose in found}
    balance = plan.balance
    lines = [
        _HEAD.format(robot=robot.name),
        f"roll: {plan.roll:g}  # of the pelvis, at most [deg]",
        f"balance: {{ joints: [{', '.join(balance.joints)}], gain: {balance.gain:g}, limit: {balance.limit:g} }}",
        "motions:",
        "  - from: [face]",
        "    to: standing",
        "    poses:",
    ]
    before = dict(zip(robot.joints, robot.nominal_posture.tolist(), strict=True))
    for pose in plan.face_down:
        angles = posture.full(pose.near | solved.get(pose.name, {}))
        angles = {name: round(angle, 3) + 0.0 for name, angle in angles.items()}
        changed = {name: angles[name] for name in robot.joints if name in angles and angles[name] != before[name]}
        before |= angles
        lines += [
            f"      - name: {pose.name}",
            f"        duration: {pose.duration:g}",
            f"        hold: {pose.hold:g}",
            f"        pitch: [{pose.pitch[0]:g}, {pose.pitch[1]:g}]",
            *(["        balanced: true"] if pose.balanced else []),
            "        joints: {",
            *(f"          {line}," for line in _rows(robot, changed)),
            "        }",
        ]
    return "\n".join(lines) + "\n"


def _rows(robot: RobotDescription, angles: Mapping[str, float]) -> list[str]:
    rows = []
    for side in ("l_", "r_", ""):
        names = [name for name in angles if (name[:2] if name[:2] in ("l_", "r_") else "") == side]
        for i in range(0, len(names), _COLUMNS):
            rows += [", ".join(f"{name}: {angles[name]:g}" for name in names[i : i + _COLUMNS])]
    return rows


if __name__ == "__main__":
    sys.exit(main())
