"""Kinematic tree of a robot's MuJoCo model, with its URDF for ``/robot_description``; ``python -m`` prints JSON.

The URDF has the tree of ``/tf``: base, bodies, and REP-120's frames fixed to them. Inertia is at the CoM in link axes,
as some readers ignore the rotation of the inertial origin. Capsules become a cylinder and two spheres, ellipsoids a
scaled sphere mesh. Meshes are the model's STL, OBJ or DAE files; other formats are omitted.
"""

import sys
from collections.abc import Iterator, Sequence
from math import atan2, hypot
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.kinematic_tree import Frame, KinematicTree, Link
from valor.robot.model import full_model, matrix

# Element, its attributes, position (3,) [m], rotation (3, 3).
Shape = tuple[str, dict[str, str], FloatArray, FloatArray]

SPHERE = Path(__file__).with_name("sphere.stl")
"""Sphere of radius 1 m, for ellipsoids."""

_READ_BY_ALL = (".stl", ".obj", ".dae")
COLLISION_GROUP = 3  # geom group of collision geoms; the others are visual
_ORIGIN = np.zeros(3)


def read(robot: RobotDescription) -> KinematicTree:
    """Return the tree of a robot's model. Raises ConfigurationError if it is invalid or a link has several joints."""
    mj = full_model(robot, "all").mj
    tables = robot.tables
    base = tables.base
    measured = {tables.imu.site, tables.feet.left.sole, tables.feet.right.sole}
    measured |= {hand.site for _, hand in tables.hands.present()} | ({tables.kvh.site} if tables.kvh else set())
    named = set(tables.link_frames.values()) | measured
    links = []
    for i in range(1, mj.nbody):
        body = mj.body(i)
        if body.name == base:
            continue
        count, first = int(mj.body_jntnum[i]), int(mj.body_jntadr[i])
        if count > 1 or (count and mj.jnt_type[first] != mujoco.mjtJoint.mjJNT_HINGE):
            raise ConfigurationError(f"{robot.model_file}: body {body.name!r}: expected at most one joint, a hinge")
        links.append(
            Link(
                body.name,
                mj.body(int(mj.body_parentid[i])).name,
                tuple(body.pos.tolist()),
                tuple(body.quat.tolist()),
                mj.joint(first).name if count else "",
                tuple(mj.jnt_axis[first].tolist()) if count else (0.0, 0.0, 1.0),
                tuple(mj.jnt_pos[first].tolist()) if count else (0.0, 0.0, 0.0),
                float(mj.body_mass[i]),
                tuple(mj.body_ipos[i].tolist()),
            )
        )
    bodies = {link.name for link in links} | {base}
    frames = []
    for site in map(mj.site, range(mj.nsite)):
        if site.name in named:
            link = mj.body(int(mj.site_bodyid[site.id])).name
            frame = robot.frame_of(site.name)
            frames.append(Frame(frame, site.name, link, tuple(site.pos.tolist()), tuple(site.quat.tolist())))
    for frame, target in tables.link_frames.items():
        if target in bodies and target not in (frame, base):
            frames.append(Frame(frame, target, target, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
    tree = KinematicTree(base, robot.frame_of(base), links, frames, urdf="")
    return msgspec.structs.replace(tree, urdf=robot_description(robot, tree, mj))


def robot_description(robot: RobotDescription, tree: KinematicTree, mj: mujoco.MjModel) -> str:
    """Return the URDF of a robot's tree, from its full model with all geoms."""
    root = ElementTree.Element("robot", name=robot.name)
    limits = CommandedLimits.of_joints(robot)
    _link(root, mj, tree.base_frame, tree.base if tree.base == tree.base_frame else "")
    if tree.base != tree.base_frame:
        _link(root, mj, tree.base, tree.base)
        _fix(root, tree.base, tree.base_frame, _ORIGIN, matrix((1.0, 0.0, 0.0, 0.0)))
    for link in tree.links:
        parent = tree.base_frame if link.parent == tree.base else link.parent
        anchor = np.array(link.anchor)
        position, rotation = np.array(link.position), matrix(link.orientation)
        child = link.name
        if link.joint and anchor.any():
            # URDF hinges go through the child's origin: a massless link is at the hinge.
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
        _link(root, mj, link.name, link.name)
    for frame in tree.frames:
        ElementTree.SubElement(root, "link", name=frame.name)
        parent = tree.base_frame if frame.link == tree.base else frame.link
        _fix(root, frame.name, parent, np.array(frame.position), matrix(frame.orientation))
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _link(root: ElementTree.Element, mj: mujoco.MjModel, name: str, body_name: str) -> None:
    """Add a link with the mass and shapes of a body; an empty body name adds an empty link."""
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
        for shape, attributes, position, rotation in _shapes(mj, geom):
            part = ElementTree.SubElement(element, kind)
            _origin(part, position, rotation)
            ElementTree.SubElement(ElementTree.SubElement(part, "geometry"), shape, attributes)
            if kind == "visual":
                _material(part, mj, geom)


def mesh_file(mj: mujoco.MjModel, mesh: int) -> Path | None:
    """Return the absolute path of a mesh file, or None if its format is not widely supported."""
    address = int(mj.mesh_pathadr[mesh])
    if address < 0:
        return None
    file = Path(mj.paths[address:].split(b"\0", 1)[0].decode()).resolve()
    return file if file.suffix.lower() in _READ_BY_ALL else None


def _shapes(mj: mujoco.MjModel, geom: int) -> Iterator[Shape]:
    """Yield the URDF shapes of a geom."""
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
        yield "mesh", {"filename": SPHERE.as_uri(), "scale": _numbers(size)}, position, rotation
    elif kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(mj.geom_dataid[geom])
        if file := mesh_file(mj, mesh):
            # MuJoCo moves a mesh into its inertia frame; convert back to the file's frame:
            rotation = rotation @ matrix(mj.mesh_quat[mesh]).T
            position = position - rotation @ mj.mesh_pos[mesh]
            yield "mesh", {"filename": file.as_uri(), "scale": _numbers(mj.mesh_scale[mesh])}, position, rotation


def _material(part: ElementTree.Element, mj: mujoco.MjModel, geom: int) -> None:
    material = int(mj.geom_matid[geom])
    color = np.round((mj.geom_rgba[geom] if material < 0 else mj.mat_rgba[material]).astype(float), 4)
    name = f"geom_{geom}" if material < 0 else mj.material(material).name
    ElementTree.SubElement(ElementTree.SubElement(part, "material", name=name), "color", rgba=_numbers(color))


def _hinge(root: ElementTree.Element, limits: CommandedLimits, place: int, link: Link) -> ElementTree.Element:
    """Add a joint with its command limits."""
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
    """Set parent, child and the child's pose in the parent at angle 0."""
    _origin(joint, position, rotation)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)


def _origin(element: ElementTree.Element, position: FloatArray, rotation: FloatArray) -> None:
    """Add an origin: R = R_z(yaw)·R_y(pitch)·R_x(roll)."""
    pitch = atan2(-rotation[2, 0], hypot(rotation[2, 1], rotation[2, 2]))
    if hypot(rotation[2, 1], rotation[2, 2]) > 1e-9:
        roll, yaw = atan2(rotation[2, 1], rotation[2, 2]), atan2(rotation[1, 0], rotation[0, 0])
    else:  # gimbal lock: roll and yaw have the same axis
        roll, yaw = 0.0, atan2(-rotation[0, 1], rotation[1, 1])
    ElementTree.SubElement(element, "origin", xyz=_numbers(position), rpy=_numbers((roll, pitch, yaw)))


def _number(value: float) -> str:
    return f"{value + 0.0:.12g}"


def _numbers(values: Sequence[float] | FloatArray) -> str:
    return " ".join(_number(value) for value in values)


def main() -> int:
    """Print the tree of the robot in the folder given as argument, as JSON."""
    try:
        tree = read(RobotDescription.load(Path(sys.argv[1])))
    except ConfigurationError as error:
        print(error, file=sys.stderr)
        return 1
    sys.stdout.buffer.write(msgspec.json.encode(tree))
    return 0


if __name__ == "__main__":
    sys.exit(main())
