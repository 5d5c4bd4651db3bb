"""Planning groups: robot.yaml's limbs, as chains where they are chains."""

from __future__ import annotations

from dataclasses import dataclass

from valor.robot.description import RobotDescription
from valor.robot.kinematic_tree import KinematicTree, Link

SIDES = ("left", "right")
BOTH_ARMS = "both_arms"
UPPER_BODY = "upper_body"


@dataclass(frozen=True)
class Group:
    """A limb.

    Attributes:
        name: robot.yaml's.
        joints: from the trunk out.
        base, tip: links between which the chain is; None of what is no chain.
    """

    name: str
    joints: tuple[str, ...]
    base: str | None = None
    tip: str | None = None


def groups(robot: RobotDescription, tree: KinematicTree) -> dict[str, Group]:
    """The limbs of a robot that have joints, by name.

    Args:
        robot: its description.
        tree: its links and frames.
    """
    wanted = _tips(robot)
    return {
        name: _group(tree, name, tuple(joints), wanted.get(name))
        for name, joints in robot.tables.groups.items()
        if joints
    }


def composites(limbs: dict[str, Group]) -> dict[str, tuple[str, ...]]:
    """Groups of limbs that a planner may move together: name → limbs."""
    arms = tuple(f"{side}_arm" for side in SIDES if f"{side}_arm" in limbs)
    found = dict[str, tuple[str, ...]]()
    if len(arms) == len(SIDES):
        found[BOTH_ARMS] = arms
    if arms and "torso" in limbs:
        found[UPPER_BODY] = ("torso", *arms)
    return found


def _tips(robot: RobotDescription) -> dict[str, str]:
    """Limb → the site at its end."""
    feet = robot.tables.feet
    tips = {"left_leg": feet.left.sole, "right_leg": feet.right.sole}
    return tips | {f"{side}_arm": hand.site for side, hand in robot.tables.hands.present()}


def _group(tree: KinematicTree, name: str, joints: tuple[str, ...], site: str | None) -> Group:
    links = {link.name: link for link in tree.links}
    moved = {link.joint: link for link in tree.links if link.joint in joints}
    last = max(moved.values(), key=lambda link: len(_above(links, link.name)))
    chain: list[Link] = []
    for link in _above(links, last.name):
        if len({each.joint for each in chain}.intersection(joints)) == len(joints):
            break
        chain.append(link)
    if {link.joint for link in chain if link.joint} != set(joints):
        return Group(name, joints)
    base = tree.base_frame if chain[-1].parent == tree.base else chain[-1].parent
    return Group(name, tuple(link.joint for link in reversed(chain) if link.joint), base, _tip(tree, links, last, site))


def _tip(tree: KinematicTree, links: dict[str, Link], last: Link, site: str | None) -> str:
    """The frame of a site if nothing moves between it and a limb's last link; else that link."""
    frame = next((frame for frame in tree.frames if frame.target == site), None)
    if frame is None:
        return last.name
    for link in _above(links, frame.link):
        if link is last:
            return frame.name
        if link.joint:
            break
    return last.name


def _above(links: dict[str, Link], name: str) -> list[Link]:
    """A link and those that it hangs from, up to the base, which is not among them."""
    found = []
    while name in links:
        found.append(links[name])
        name = links[name].parent
    return found
