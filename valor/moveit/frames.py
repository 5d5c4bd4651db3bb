"""Names of frames where several robots share tf: with the robot's prefix, so that MoveIt finds its links there.

tf's frames bear it, while joints, groups and controllers are told apart by the namespace in which they are.
"""

from __future__ import annotations

from xml.etree import ElementTree

_NAMES = {
    "link": ("name",),
    "parent": ("link",),
    "child": ("link",),
    "chain": ("base_link", "tip_link"),
    "end_effector": ("parent_link",),
    "virtual_joint": ("parent_frame", "child_link"),
    "disable_collisions": ("link1", "link2"),
}
"""Attributes that name frames, of the elements of URDF and SRDF."""


def prefixed(text: str, prefix: str) -> str:
    """A URDF or an SRDF whose frames are named with a prefix; empty: as it is."""
    if not prefix:
        return text
    declaration, _, content = text.partition("\n")
    root = ElementTree.fromstring(content)
    for element in root.iter():
        for attribute in _NAMES.get(element.tag, ()):
            element.set(attribute, prefix + element.attrib[attribute])
    return f"{declaration}\n{ElementTree.tostring(root, encoding='unicode')}\n"
