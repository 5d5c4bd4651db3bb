"""What must hold between the tables of robot.yaml, without a model: each rule finds what breaks it.

Rules that need the robot's geometry stand in ``checks.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

from valor.common.table import TableError
from valor.robot.tables import RobotTables

REQUIRED_GROUPS = ("left_leg", "right_leg")
"""What a robot cannot stand without. Any other limb may be lacking, its group empty or absent."""

LEG_JOINTS = 6


def groups_are_there(tables: RobotTables) -> Iterator[TableError]:
    """A robot has legs."""
    for group in REQUIRED_GROUPS:
        if not tables.group(group):
            what = "got no joints; expected a leg's" if group in tables.groups else "expected, but missing"
            yield TableError(("groups", group), what)


def every_joint_is_in_one_group(tables: RobotTables) -> Iterator[TableError]:
    """Each joint stands in one group, once."""
    owner: dict[str, str] = {}
    for group, members in tables.groups.items():
        for place, joint in enumerate(members):
            if joint not in tables.joints:
                yield TableError(("groups", group, str(place)), f"got {joint!r}; expected one of joints")
            elif joint in owner:
                what = f"got {joint!r}, which is in {owner[joint]}; expected each joint in one group"
                yield TableError(("groups", group, str(place)), what)
            owner[joint] = group
    for joint in tables.joints:
        if joint not in owner:
            yield TableError(("joints", joint), "in no group; expected it in one of groups")


def passive_joints_are_others(tables: RobotTables) -> Iterator[TableError]:
    """What nothing drives is none of joints."""
    for name in tables.passive:
        if name in tables.joints:
            yield TableError(("passive", name), "is one of joints; expected a hinge that nothing drives")


def legs_have_six_joints(tables: RobotTables) -> Iterator[TableError]:
    """A leg has six joints, by which its sole can be put in any pose."""
    for group in REQUIRED_GROUPS:
        if (members := tables.group(group)) and len(members) != LEG_JOINTS:
            what = f"{len(members)} joints; expected {LEG_JOINTS}, by which a sole can be put in any pose"
            yield TableError(("groups", group), what)


def postures_are_within_limits(tables: RobotTables) -> Iterator[TableError]:
    """Nominal posture, presets and calibration pose name joints of theirs, within the joints' limits."""
    everything = list(tables.joints)
    yield from _posture(tables, ("nominal_posture",), tables.nominal_posture, everything)
    yield from _posture(tables, ("calibration", "pose"), tables.calibration.pose, everything)
    for limb, presets in (("arm", tables.arm_presets), ("hand", tables.hand_presets)):
        for preset, sides in presets.items():
            for side, posture in sides.items():
                members = tables.group(f"{side}_{limb}")
                yield from _posture(tables, (f"{limb}_presets", preset, side), posture, members)


def _posture(
    tables: RobotTables, path: tuple[str, ...], posture: Mapping[str, float], members: list[str]
) -> Iterator[TableError]:
    for name, angle in posture.items():
        if name not in members:
            what = "one of joints" if len(members) == len(tables.joints) else f"one of {', '.join(members) or 'none'}"
            yield TableError((*path, name), f"unknown joint; expected {what}")
            continue
        if (joint := tables.joints.get(name)) is None:  # which a rule of groups tells
            continue
        if joint.lower is None and abs(angle) > math.tau:
            yield TableError((*path, name), f"got {angle}; expected radians, at most a turn")
        if joint.lower is not None and joint.upper is not None and not joint.lower <= angle <= joint.upper:
            yield TableError((*path, name), f"got {angle}; expected {joint.lower} to {joint.upper}, the joint's limits")


def offsets_name_joints(tables: RobotTables) -> Iterator[TableError]:
    """Encoder offsets are of joints that there are."""
    for name in tables.calibration.offsets:
        if name not in tables.joints:
            yield TableError(("calibration", "offsets", name), "unknown joint; expected one of joints")


def gears_name_joints_or_groups(tables: RobotTables) -> Iterator[TableError]:
    """What an actuator profile says of single gears is of joints or groups that there are."""
    for profile, actuators in tables.actuators.items():
        for name in actuators.gears:
            if name not in tables.joints and name not in tables.groups:
                yield TableError(("actuators", profile, "gears", name), "expected one of joints or groups")


def limbs_are_distinct(tables: RobotTables) -> Iterator[TableError]:
    """Left and right foot, and hand, are two bodies with a site each."""
    for limbs, keys in (("feet", ("body", "sole")), ("hands", ("body", "site"))):
        pair = getattr(tables, limbs)
        if pair.left is None or pair.right is None:
            continue
        for key in keys:
            name = getattr(pair.left, key)
            if name == getattr(pair.right, key):
                yield TableError((limbs, "right", key), f"got {name!r}, as {limbs}.left has; expected another")


def pairs_are_distinct(tables: RobotTables) -> Iterator[TableError]:
    """What is kept apart is two bodies, named once."""
    seen: set[frozenset[str]] = set()
    for place, pair in enumerate(tables.self_collision.pairs):
        if len(set(pair)) < 2 or frozenset(pair) in seen:
            what = f"got {' and '.join(pair)}; expected two bodies that no other pair has"
            yield TableError(("self_collision", "pairs", str(place)), what)
        seen.add(frozenset(pair))


def steps_fit_each_other(tables: RobotTables) -> Iterator[TableError]:
    """Walking is as wide as footsteps may be; the leg reaches farther than the hip is high."""
    walking, footsteps = tables.walking, tables.footsteps
    if walking.hip_height >= walking.leg_reach:
        what = f"got {walking.leg_reach}; expected more than hip_height, {walking.hip_height}"
        yield TableError(("walking", "leg_reach"), what)
    if footsteps is not None and not footsteps.min_width <= walking.step_width <= footsteps.max_width:
        what = f"got {walking.step_width}; expected {footsteps.min_width} to {footsteps.max_width}, as footsteps says"
        yield TableError(("walking", "step_width"), what)


def every_joint_has_one_device(tables: RobotTables) -> Iterator[TableError]:
    """No joint is moved by two devices, and devices move joints that there are."""
    owner: dict[str, str] = {}
    for name in tables.devices:
        for group in tables.devices[name].groups:
            if group not in tables.groups:
                yield TableError(("devices", name), f"got the group {group!r}; expected one of groups")
                return
        for joint in tables.device_joints(name):
            if joint not in tables.joints:
                yield TableError(("devices", name), f"got the joint {joint!r}; expected one of joints")
            elif joint in owner:
                yield TableError(("devices", name), f"got the joint {joint!r}, which {owner[joint]} moves already")
            owner[joint] = name


def sensors_are_on_limbs_that_there_are(tables: RobotTables) -> Iterator[TableError]:
    """A force sensor at a hand needs that hand."""
    there = {"left_foot", "right_foot", *(f"{side}_hand" for side, _ in tables.hands.present())}
    for name, device in tables.devices.items():
        for place in getattr(device, "places", ()):
            if place not in there:
                what = f"has a sensor at {place}; expected one of {', '.join(sorted(there))}, or that hand in hands"
                yield TableError(("devices", name), what)


RULES: tuple[Callable[[RobotTables], Iterator[TableError]], ...] = (
    groups_are_there,
    every_joint_is_in_one_group,
    passive_joints_are_others,
    legs_have_six_joints,
    postures_are_within_limits,
    offsets_name_joints,
    gears_name_joints_or_groups,
    limbs_are_distinct,
    pairs_are_distinct,
    steps_fit_each_other,
    every_joint_has_one_device,
    sensors_are_on_limbs_that_there_are,
)
"""In the order in which they are tried."""


def broken_rules(tables: RobotTables) -> Iterator[TableError]:
    """What breaks any of them."""
    for rule in RULES:
        yield from rule(tables)
