"""Checks of robot.yaml that need no model. Each check yields its violations."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping

from valor.common.table import TableError
from valor.devices.kinds import KINDS, Quantity
from valor.robot.tables import RobotTables

REQUIRED_GROUPS = ("left_leg", "right_leg")
"""Groups that every robot has. Any other group may be empty or absent."""

LEG_JOINTS = 6


def legs_have_six_joints(tables: RobotTables) -> Iterator[TableError]:
    """Check that the robot has two legs of the six joints that reach any pose of a sole."""
    for group in REQUIRED_GROUPS:
        if not (members := tables.group(group)):
            what = "got no joints; expected a leg's" if group in tables.groups else "expected, but missing"
            yield TableError(("groups", group), what)
        elif len(members) != LEG_JOINTS:
            what = f"{len(members)} joints; expected {LEG_JOINTS}, which reach any pose of the sole"
            yield TableError(("groups", group), what)


def every_joint_is_in_one_group(tables: RobotTables) -> Iterator[TableError]:
    """Check that each joint is in exactly one group."""
    owner: dict[str, str] = {}
    for group, members in tables.groups.items():
        for index, joint in enumerate(members):
            if joint not in tables.joints:
                yield TableError(("groups", group, str(index)), f"got {joint!r}; expected one of joints")
            elif joint in owner:
                what = f"got {joint!r}, which is in {owner[joint]}; expected each joint in one group"
                yield TableError(("groups", group, str(index)), what)
            owner[joint] = group
    for joint in tables.joints:
        if joint not in owner:
            yield TableError(("joints", joint), "in no group; expected it in one of groups")


def postures_are_within_limits(tables: RobotTables) -> Iterator[TableError]:
    """Check that postures name joints of their limb, within the limits."""
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
        if (joint := tables.joints.get(name)) is None:  # reported by the checks of groups
            continue
        if joint.lower is None and abs(angle) > math.tau:
            yield TableError((*path, name), f"got {angle}; expected radians, at most a turn")
        if joint.lower is not None and joint.upper is not None and not joint.lower <= angle <= joint.upper:
            yield TableError((*path, name), f"got {angle}; expected {joint.lower} to {joint.upper}, the joint's limits")


def names_exist(tables: RobotTables) -> Iterator[TableError]:
    """Check that encoder offsets, gears and springs name existing joints, and passive joints have no drive."""
    for name in tables.calibration.offsets:
        if name not in tables.joints:
            yield TableError(("calibration", "offsets", name), "unknown joint; expected one of joints")
    for profile, actuators in tables.actuators.items():
        for name in actuators.gears:
            if name not in tables.joints and name not in tables.groups:
                yield TableError(("actuators", profile, "gears", name), "expected one of joints or groups")
        for name in () if actuators.springs is None else actuators.springs.actuators:
            if name not in tables.joints or not tables.joints[name].armature:
                what = "expected one of joints, whose armature is the motor's inertia, above 0"
                yield TableError(("actuators", profile, "springs", "actuators", name), what)
    for name in tables.passive:
        if name in tables.joints:
            yield TableError(("passive", name), "is one of joints; expected a hinge without a drive")


def limbs_are_distinct(tables: RobotTables) -> Iterator[TableError]:
    """Check that left and right foot, and hand, are two bodies with separate sites."""
    for limbs, keys in (("feet", ("body", "sole")), ("hands", ("body", "site"))):
        pair = getattr(tables, limbs)
        if pair.left is None or pair.right is None:
            continue
        for key in keys:
            name = getattr(pair.left, key)
            if name == getattr(pair.right, key):
                yield TableError((limbs, "right", key), f"got {name!r}, as {limbs}.left has; expected another")


def pairs_are_distinct(tables: RobotTables) -> Iterator[TableError]:
    """Check that pairs of ``self_collision`` are two bodies, each pair once."""
    seen: set[frozenset[str]] = set()
    for index, pair in enumerate(tables.self_collision.pairs):
        if len(set(pair)) < 2 or frozenset(pair) in seen:
            what = f"got {' and '.join(pair)}; expected two bodies that no other pair has"
            yield TableError(("self_collision", "pairs", str(index)), what)
        seen.add(frozenset(pair))


def steps_fit_each_other(tables: RobotTables) -> Iterator[TableError]:
    """Check that step_width is within the footsteps' widths and leg_reach above hip_height."""
    walking, footsteps = tables.walking, tables.footsteps
    if walking.hip_height >= walking.leg_reach:
        what = f"got {walking.leg_reach}; expected more than hip_height, {walking.hip_height}"
        yield TableError(("walking", "leg_reach"), what)
    if footsteps is not None and not footsteps.min_width <= walking.step_width <= footsteps.max_width:
        what = f"got {walking.step_width}; expected {footsteps.min_width} to {footsteps.max_width}, as of footsteps"
        yield TableError(("walking", "step_width"), what)


def every_joint_has_one_device(tables: RobotTables) -> Iterator[TableError]:
    """Check that devices drive existing joints, each joint by one device."""
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
                yield TableError(("devices", name), f"got the joint {joint!r}, which {owner[joint]} drives as well")
            owner[joint] = name


def sensors_are_on_existing_limbs(tables: RobotTables) -> Iterator[TableError]:
    """Check that force sensors are at existing feet and hands."""
    limbs = {"left_foot", "right_foot", *(f"{side}_hand" for side, _ in tables.hands.present())}
    for name, device in tables.devices.items():
        for limb in getattr(device, "places", ()):
            if limb not in limbs:
                what = f"has a sensor at {limb}; expected one of {', '.join(sorted(limbs))}, or that hand in hands"
                yield TableError(("devices", name), what)


def devices_are_complete(tables: RobotTables) -> Iterator[TableError]:
    """Check that devices move each joint, measure the attitude, the force at both feet or none, and each force once.

    Only for hardware: in simulation a robot needs no devices.
    """
    kinds = {name: KINDS[device.kind] for name, device in tables.devices.items()}
    moved = Counter(joint for name in kinds for joint in tables.device_joints(name))
    measured = Counter[str](place for name in kinds for place in tables.devices[name].places)
    problems = []
    if missing := [joint for joint in tables.joints if not moved[joint]]:
        problems.append(f"none moves {', '.join(missing)}")
    if not any(kind.provides & Quantity.ATTITUDE for kind in kinds.values()):
        problems.append("0 IMUs; expected one, for the pelvis' attitude")
    if len(missing := [place for place in ("left_foot", "right_foot") if not measured[place]]) == 1:
        problems.append(f"no force/torque sensor at {missing[0]}; expected one in each foot, or in neither")
    if twice := [what for what, count in (moved + measured).items() if count > 1]:
        problems.append(f"{', '.join(twice)}: in more than one device")
    if problems:
        yield TableError(("devices",), "; ".join(problems))


def violations(tables: RobotTables) -> Iterator[TableError]:
    """Yield the violations of all rules."""
    for rule in (
        legs_have_six_joints,
        every_joint_is_in_one_group,
        names_exist,
        postures_are_within_limits,
        limbs_are_distinct,
        pairs_are_distinct,
        steps_fit_each_other,
        every_joint_has_one_device,
        sensors_are_on_existing_limbs,
    ):
        yield from rule(tables)
