"""``/robot_description``: the robot's one model as URDF, for RViz, MoveIt and other tools of ROS.

Its tree is that of ``/tf``: the base's frame, the bodies under it, REP-120's frames fixed to them. Every link's frame
is its body's, so that a joint angle means the same in both. Inertia is given at the link's CoM in the link's axes,
for some readers pass over the inertial origin's rotation. URDF has neither capsules nor ellipsoids: they become a
cylinder and two spheres, and a stretched mesh of one. A mesh is the file that the model names, STL, OBJ or DAE, where
it lies; one that only MuJoCo reads is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import atan2, hypot
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.kinematic_tree import KinematicTree, Link
from valor.robot.quaternion import matrix

# Element, its attributes, position (3,) [m], rotation (3, 3).
Shape = tuple[str, dict[str, str], FloatArray, FloatArray]

MeshUri = Callable[[Path], str]
"""How a description names a mesh's file."""

SPHERE = Path(__file__).with_name("sphere.stl")
"""Of radius 1 m, for ellipsoids."""

_READ_BY_ALL = (".stl", ".obj", ".dae")
COLLISION_GROUP = 3  # of the model's geoms that collide; the others are seen
_ORIGIN = np.zeros(3)


def robot_description(
    robot: RobotDescription, tree: KinematicTree, mj: mujoco.MjModel, mesh_uri: MeshUri = Path.as_uri
) -> str:
    """The URDF.

    Args:
        robot: its description.
        tree: links, joints and frames.
        mj: the full model, with all geoms: inertias and shapes.
        mesh_uri: of an absolute path; by ``file:``, who reads it on this computer finds every mesh.
    """
    root = ElementTree.Element("robot", name=robot.name)
    limits = CommandedLimits.of_joints(robot)
    _link(root, mj, tree.base_frame, tree.base if tree.base == tree.base_frame else "", mesh_uri)
    if tree.base != tree.base_frame:
        _link(root, mj, tree.base, tree.base, mesh_uri)
        _fix(root, tree.base, tree.base_frame, _ORIGIN, matrix((1.0, 0.0, 0.0, 0.0)))
    for link in tree.links:
        parent = tree.base_frame if link.parent == tree.base else link.parent
        anchor = np.array(link.anchor)
        position, rotation = np.array(link.position), matrix(link.orientation)
        child = link.name
        if link.joint and anchor.any():
            # URDF hinges go through the child's origin: a link without mass stands where the hinge is.
            child = f"{link.name}_hinge"
            ElementTree.SubElement(root, "link", name=child)
            _fix(root, link.name, child, -anchor, np.eye(3))
        if link.joint:
            joint = _hinge(root, limits, robot.index[link.joint], link)
            damping = robot.tables.joints[link.joint].damping
            ElementTree.SubElement(joint, "dynamics", damping=_number(damping))
            _place(joint, child, parent, position + rotation @ anchor, rotation)
        else:
            _fix(root, child, parent, position, rotation)
        _link(root, mj, link.name, link.name, mesh_uri)
    for frame in tree.frames:
        ElementTree.SubElement(root, "link", name=frame.name)
        parent = tree.base_frame if frame.link == tree.base else frame.link
        _fix(root, frame.name, parent, np.array(frame.position), matrix(frame.orientation))
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _link(root: ElementTree.Element, mj: mujoco.MjModel, name: str, body_name: str, mesh_uri: MeshUri) -> None:
    """A link with the mass and the shapes of a body; an empty name: of none."""
    element = ElementTree.SubElement(root, "link", name=name)
    if not body_name:
        return
    body = mj.body(body_name).id
    if mj.body_mass[body] > 0.0:
        inertial = ElementTree.SubElement(element, "inertial")
        _origin(inertial, mj.body_ipos[body], np.eye(3))
        ElementTree.SubElement(inertial, "mass", value=_number(mj.body_mass[body]))
        axes = matrix(mj.body_iquat[body])
        inertia = axes @ np.diag(mj.body_inertia[body]) @ axes.T
        entries = {f"i{'xyz'[i]}{'xyz'[j]}": _number(inertia[i, j]) for i in range(3) for j in range(i, 3)}
        ElementTree.SubElement(inertial, "inertia", entries)
    first = int(mj.body_geomadr[body])
    for geom in range(first, first + int(mj.body_geomnum[body])):
        kind = "collision" if mj.geom_group[geom] == COLLISION_GROUP else "visual"
        for shape, attributes, position, rotation in _shapes(mj, geom, mesh_uri):
            part = ElementTree.SubElement(element, kind)
            _origin(part, position, rotation)
            ElementTree.SubElement(ElementTree.SubElement(part, "geometry"), shape, attributes)
            if kind == "visual":
                _material(part, mj, geom)


def mesh_file(mj: mujoco.MjModel, mesh: int) -> Path | None:
    """The absolute path of the file that a mesh was read from; None where there is none that all can read."""
    place = int(mj.mesh_pathadr[mesh])
    if place < 0:
        return None
    file = Path(mj.paths[place:].split(b"\0", 1)[0].decode()).resolve()
    return file if file.suffix.lower() in _READ_BY_ALL else None


def _shapes(mj: mujoco.MjModel, geom: int, mesh_uri: MeshUri) -> Iterator[Shape]:
    """What stands for a geom."""
    size, position, rotation = mj.geom_size[geom], mj.geom_pos[geom], matrix(mj.geom_quat[geom])
    kind = mujoco.mjtGeom(mj.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        yield "box", {"size": _numbers(2.0 * size)}, position, rotation
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        yield "sphere", {"radius": _number(size[0])}, position, rotation
    elif kind in (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE):
        yield "cylinder", {"radius": _number(size[0]), "length": _number(2.0 * size[1])}, position, rotation
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            for end in (-size[1], size[1]):
                yield "sphere", {"radius": _number(size[0])}, position + end * rotation[:, 2], rotation
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        yield "mesh", {"filename": mesh_uri(SPHERE), "scale": _numbers(size)}, position, rotation
    elif kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(mj.geom_dataid[geom])
        if file := mesh_file(mj, mesh):
            # MuJoCo moves a mesh into the frame of its inertia; the file's own frame stands there:
            rotation = rotation @ matrix(mj.mesh_quat[mesh]).T
            position = position - rotation @ mj.mesh_pos[mesh]
            yield "mesh", {"filename": mesh_uri(file), "scale": _numbers(mj.mesh_scale[mesh])}, position, rotation


def _material(part: ElementTree.Element, mj: mujoco.MjModel, geom: int) -> None:
    material = int(mj.geom_matid[geom])
    color = np.round((mj.geom_rgba[geom] if material < 0 else mj.mat_rgba[material]).astype(float), 4)
    name = f"geom_{geom}" if material < 0 else mj.material(material).name
    ElementTree.SubElement(ElementTree.SubElement(part, "material", name=name), "color", rgba=_numbers(color))


def _hinge(root: ElementTree.Element, limits: CommandedLimits, place: int, link: Link) -> ElementTree.Element:
    """A joint of the robot, with the limits of what it may be commanded."""
    lower, upper = limits.lower[place], limits.upper[place]
    bounded = bool(np.isfinite(lower))
    joint = ElementTree.SubElement(root, "joint", name=link.joint, type="revolute" if bounded else "continuous")
    ElementTree.SubElement(joint, "axis", xyz=_numbers(link.axis))
    limit = {"effort": _number(limits.effort[place]), "velocity": _number(limits.velocity[place])}
    if bounded:
        limit |= {"lower": _number(lower), "upper": _number(upper)}
    ElementTree.SubElement(joint, "limit", limit)
    return joint


def _fix(root: ElementTree.Element, child: str, parent: str, position: FloatArray, rotation: FloatArray) -> None:
    joint = ElementTree.SubElement(root, "joint", name=f"{child}_fixed", type="fixed")
    _place(joint, child, parent, position, rotation)


def _place(joint: ElementTree.Element, child: str, parent: str, position: FloatArray, rotation: FloatArray) -> None:
    """What a joint joins, and where the child stands in the parent at angle 0."""
    _origin(joint, position, rotation)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)


def _origin(element: ElementTree.Element, position: FloatArray, rotation: FloatArray) -> None:
    """Where something stands: R = R_z(yaw)·R_y(pitch)·R_x(roll)."""
    pitch = atan2(-rotation[2, 0], hypot(rotation[2, 1], rotation[2, 2]))
    if hypot(rotation[2, 1], rotation[2, 2]) > 1e-9:
        roll, yaw = atan2(rotation[2, 1], rotation[2, 2]), atan2(rotation[1, 0], rotation[0, 0])
    else:  # straight up or down: roll and yaw turn about one axis
        roll, yaw = 0.0, atan2(-rotation[0, 1], rotation[1, 1])
    ElementTree.SubElement(element, "origin", xyz=_numbers(position), rpy=_numbers((roll, pitch, yaw)))


def _number(value: float) -> str:
    return f"{value + 0.0:.12g}"


def _numbers(values: Sequence[float] | FloatArray) -> str:
    return " ".join(_number(value) for value in values)
