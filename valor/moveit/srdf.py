"""SRDF: what a planner is told of a robot beside its URDF.

As srdfdom reads it: groups, their named states, end effectors, where the robot stands in the world, and pairs of links
that cannot touch.
"""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree

from valor.moveit.collisions import Collisions, Pair, posture
from valor.moveit.groups import BOTH_ARMS, SIDES, Group, composites
from valor.robot.description import RobotDescription

VIRTUAL_JOINT = "world_joint"
ODOM = "odom"
"""The frame that the robot's base is published in; MoveIt plans in it."""

NOMINAL = "nominal"
State = tuple[str, str, Mapping[str, float]]  # name, group, joint → angle [rad]


def srdf(
    robot: RobotDescription,
    base_frame: str,
    limbs: Mapping[str, Group],
    collisions: Collisions,
    disabled: Mapping[Pair, str],
) -> str:
    """The SRDF.

    Args:
        robot: its description.
        base_frame: the URDF's root.
        limbs: its groups.
        collisions: its shapes.
        disabled: pairs of links that are not looked at, and why.
    """
    root = ElementTree.Element("robot", name=robot.name)
    for group in limbs.values():
        element = ElementTree.SubElement(root, "group", name=group.name)
        if group.base and group.tip:
            ElementTree.SubElement(element, "chain", base_link=group.base, tip_link=group.tip)
        else:
            for joint in group.joints:
                ElementTree.SubElement(element, "joint", name=joint)
    together = composites(dict(limbs))
    for name, parts in together.items():
        element = ElementTree.SubElement(root, "group", name=name)
        for part in parts:
            ElementTree.SubElement(element, "group", name=part)
    for name, of, angles in states(robot, limbs, together, collisions, disabled):
        element = ElementTree.SubElement(root, "group_state", name=name, group=of)
        for joint, angle in angles.items():
            ElementTree.SubElement(element, "joint", name=joint, value=f"{angle:.6g}")
    for side in SIDES:
        hand, arm = limbs.get(f"{side}_hand"), limbs.get(f"{side}_arm")
        if hand and arm and arm.tip:
            names = {"name": hand.name, "group": hand.name, "parent_link": arm.tip, "parent_group": arm.name}
            ElementTree.SubElement(root, "end_effector", names)
    place = {"name": VIRTUAL_JOINT, "type": "floating", "parent_frame": ODOM, "child_link": base_frame}
    ElementTree.SubElement(root, "virtual_joint", place)
    for (one, other), reason in disabled.items():
        ElementTree.SubElement(root, "disable_collisions", link1=one, link2=other, reason=reason)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def states(
    robot: RobotDescription,
    limbs: Mapping[str, Group],
    together: Mapping[str, tuple[str, ...]],
    collisions: Collisions,
    disabled: Mapping[Pair, str],
) -> list[State]:
    """The nominal posture of every group, and robot.yaml's presets; of both arms at once where they do not touch."""
    nominal = dict(zip(robot.joints, robot.nominal_posture.tolist(), strict=True))
    found: list[State] = [(NOMINAL, limb.name, {j: nominal[j] for j in limb.joints}) for limb in limbs.values()]
    for name, parts in together.items():
        found.append((NOMINAL, name, {j: nominal[j] for part in parts for j in limbs[part].joints}))
    for kind, presets in (("arm", robot.tables.arm_presets), ("hand", robot.tables.hand_presets)):
        for preset, sides in presets.items():
            found += [(preset, f"{side}_{kind}", angles) for side, angles in sides.items() if f"{side}_{kind}" in limbs]
            both = {joint: angle for angles in sides.values() for joint, angle in angles.items()}
            whole = kind == "arm" and BOTH_ARMS in together and len(sides) == len(SIDES)
            if whole and not collisions.touching(posture(robot, both)) - set(disabled):
                found.append((preset, BOTH_ARMS, both))
    return found
