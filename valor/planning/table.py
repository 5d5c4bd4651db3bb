"""Key poses as ``get_up.yaml``, the table that the Motion Manager goes through."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from valor.planning.key_poses import KeyPose
from valor.planning.plan_table import GetUpPlan
from valor.planning.posture import SagittalPosture
from valor.robot.description import RobotDescription

FILE = "get_up.yaml"  # in the robot's folder
_HEAD = """\
# How {robot} gets up: key poses, made one after the other by the joints' servos (motion_manager/locomotion/get_up.py).
# Made from get_up_plan.yaml by `python -m valor.planning robots/{robot}`: change that, not this.
# Duration and hold [s], joints [rad] (those that a pose does not name stay), pitch: of the pelvis afterwards, from and
# to [deg]; outside of that it is given up.
"""
_COLUMNS = 6  # joints in a line


def text(posture: SagittalPosture, plan: GetUpPlan, found: Sequence[KeyPose]) -> str:
    """The file's whole content; a pose names the joints that it moves."""
    robot = posture.model.robot
    solved = {pose.plan.name: dict(zip(posture.joints, pose.coordinates[3:].tolist(), strict=True)) for pose in found}
    balance = plan.balance
    lines = [
        _HEAD.format(robot=robot.name),
        f"roll: {plan.roll:g}  # of the pelvis, at most [deg]",
        f"balance: {{ joints: [{', '.join(balance.joints)}], gain: {balance.gain:g}, limit: {balance.limit:g} }}",
        "face_down:",
    ]
    before = dict(zip(robot.joints, robot.nominal_posture.tolist(), strict=True))
    for pose in plan.face_down:
        angles = posture.full(pose.near | solved.get(pose.name, {}))
        angles = {name: round(angle, 3) + 0.0 for name, angle in angles.items()}
        changed = {name: angles[name] for name in robot.joints if name in angles and angles[name] != before[name]}
        before |= angles
        lines += [
            f"  - name: {pose.name}",
            f"    duration: {pose.duration:g}",
            f"    hold: {pose.hold:g}",
            f"    pitch: [{pose.pitch[0]:g}, {pose.pitch[1]:g}]",
            *(["    balanced: true"] if pose.balanced else []),
            "    joints: {",
            *(f"      {line}," for line in _rows(robot, changed)),
            "    }",
        ]
    return "\n".join(lines) + "\n"


def _rows(robot: RobotDescription, angles: Mapping[str, float]) -> list[str]:
    """Lines of joints, each side on lines of its own."""
    rows = []
    for side in ("l_", "r_", ""):
        names = [name for name in angles if (name[:2] if name[:2] in ("l_", "r_") else "") == side]
        for i in range(0, len(names), _COLUMNS):
            rows += [", ".join(f"{name}: {angles[name]:g}" for name in names[i : i + _COLUMNS])]
    return rows
