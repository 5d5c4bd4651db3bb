"""A robot that lacks limbs: another one's folder with bodies cut off, or with joints that turn the other way."""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

import mujoco

from valor.common.table import plain
from valor.robot.description import RobotDescription

WELDED = "torso"  # what it carries stays on


def cut(robot: RobotDescription, folder: Path, *groups: str) -> RobotDescription:
    """Take the bodies of groups off, with all that hangs on them; the waist is welded instead.

    Args:
        robot: whole.
        folder: that the cut one is written to.
        groups: that it shall lack.
    """
    spec = mujoco.MjSpec.from_file(str(robot.model_file))
    for group in groups:
        for name in robot.tables.group(group):
            joint = next((each for each in spec.joints if each.name == name), None)
            if joint is not None:  # it did not hang on another
                spec.delete(joint if group == WELDED else joint.parent)
    bodies = {body.name for body in spec.bodies}
    for exclude in list(spec.excludes):
        if not {exclude.bodyname1, exclude.bodyname2} <= bodies:
            spec.delete(exclude)
    known = bodies | {site.name for site in spec.sites}
    joints = {joint.name for joint in spec.joints}
    content = plain(robot.tables)
    _keep(content, joints)
    members_left = {name: [each for each in members if each in joints] for name, members in content["groups"].items()}
    content["groups"] = {name: members for name, members in members_left.items() if members}
    if content["head"] not in bodies:
        del content["head"]
    for sensor in ("lidar", "camera"):
        if (content.get(sensor) or {}).get("body") not in bodies:
            content.pop(sensor, None)
    for side in ("left", "right"):
        if content["hands"][side]["body"] not in bodies:
            del content["hands"][side]
        for presets in (content["arm_presets"], content["hand_presets"]):
            for sides in presets.values():
                if side in sides and not set(sides[side]) <= joints:
                    del sides[side]
    pairs = content["self_collision"]["pairs"]
    content["self_collision"]["pairs"] = [pair for pair in pairs if set(pair) <= bodies]
    content["link_frames"] = {frame: name for frame, name in content["link_frames"].items() if name in known}
    mj = spec.compile()
    content["size"]["mass"] = float(mj.body_subtreemass[mj.body(content["base"]).id])
    return _write(content, spec, folder)


def turned(robot: RobotDescription, folder: Path, names: Collection[str]) -> RobotDescription:
    """Let joints of a robot count their angles the other way."""
    spec = mujoco.MjSpec.from_file(str(robot.model_file))
    content = plain(robot.tables)
    for joint in spec.joints:
        if joint.name in names:
            joint.axis = [-value for value in joint.axis]
            table = content["joints"][joint.name]
            table["lower"], table["upper"] = -table["upper"], -table["lower"]
    posture = content["nominal_posture"]
    content["nominal_posture"] = {name: -angle if name in names else angle for name, angle in posture.items()}
    return _write(content, spec, folder)


def _keep(content: dict[str, Any], joints: Collection[str]) -> None:
    """Only these joints, and no hardware."""
    for place in (content["joints"], content["nominal_posture"]):
        for name in [name for name in place if name not in joints]:
            del place[name]
    content["devices"], content["calibration"] = {}, {}
    for profile in content["actuators"].values():
        profile["gears"] = {}


def _write(content: dict[str, Any], spec: mujoco.MjSpec, folder: Path) -> RobotDescription:
    folder.mkdir(parents=True, exist_ok=True)
    spec.compile()
    (folder / content["model"]).write_text(spec.to_xml())
    (folder / "robot.yaml").write_text(json.dumps(content, indent=2))  # JSON is YAML
    return RobotDescription.load(folder)
