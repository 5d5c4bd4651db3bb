"""The URDF is the robot's one model, to others' readers: MuJoCo's importer of URDF, and the XML itself."""

import itertools
from pathlib import Path
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from harness.places import ROBOTS
from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import VELOCITY_FACTOR
from valor.robot.description import RobotDescription
from valor.robot.kinematic_tree import KinematicTree
from valor.robot.model import full_model
from valor.robot.model_tree import SPHERE, read

NAMES = sorted(path.parent.name for path in ROBOTS.glob("*/robot.yaml"))


def imported(urdf: str) -> mujoco.MjModel:
    """The URDF as MuJoCo reads it, every link a body; the base is fixed to the world."""
    spec = mujoco.MjSpec.from_string(urdf)
    spec.compiler.fusestatic = False
    spec.compiler.discardvisual = False
    spec.compiler.balanceinertia = False
    return spec.compile()


@pytest.fixture(scope="module", params=NAMES)
def robot(request: pytest.FixtureRequest) -> RobotDescription:
    return RobotDescription.load(ROBOTS / request.param)


@pytest.fixture(scope="module")
def tree(robot: RobotDescription) -> KinematicTree:
    return read(robot)


def test_links_and_frames_stand_where_the_model_puts_them(robot: RobotDescription, tree: KinematicTree) -> None:
    model, theirs = full_model(robot), imported(tree.urdf)
    ours, other = mujoco.MjData(model.mj), mujoco.MjData(theirs)
    rng = np.random.default_rng(0)
    sites = {frame.name: frame.target for frame in tree.frames}
    for _ in range(20):
        angles = dict(zip(robot.joints, rng.uniform(-1.5, 1.5, len(robot.joints)), strict=True))
        ours.qpos[:7] = 0.0
        ours.qpos[3] = 1.0
        for name, angle in angles.items():
            ours.qpos[model.mj.joint(name).qposadr] = angle
            other.qpos[theirs.joint(name).qposadr] = angle
        mujoco.mj_kinematics(model.mj, ours)
        mujoco.mj_kinematics(theirs, other)
        for name in [tree.base, *(link.name for link in tree.links)]:
            there = other.body(name)
            assert there.xpos == pytest.approx(ours.body(name).xpos, abs=1e-9), name
            assert abs(there.xquat @ ours.body(name).xquat) == pytest.approx(1.0, abs=1e-9), name
        for frame, target in sites.items():
            there = other.body(frame).xpos
            body = mujoco.mj_name2id(model.mj, mujoco.mjtObj.mjOBJ_SITE, target) < 0
            assert there == pytest.approx((ours.body if body else ours.site)(target).xpos, abs=1e-9), frame


def test_masses_and_inertias_are_the_models(robot: RobotDescription, tree: KinematicTree) -> None:
    """Of every link; and all together, in the joints' mass matrix."""
    model, theirs = full_model(robot), imported(tree.urdf)
    assert theirs.body_mass.sum() == pytest.approx(model.mj.body_mass.sum(), rel=1e-9)
    for name in [tree.base, *(link.name for link in tree.links)]:
        here, there = model.mj.body(name).id, theirs.body(name).id
        assert theirs.body_mass[there] == pytest.approx(model.mj.body_mass[here], rel=1e-9), name
        assert theirs.body_ipos[there] == pytest.approx(model.mj.body_ipos[here], abs=1e-9), name
        assert sorted(theirs.body_inertia[there]) == pytest.approx(sorted(model.mj.body_inertia[here]), rel=1e-6), name
    rng = np.random.default_rng(1)
    angles = rng.uniform(-1.5, 1.5, len(robot.joints))
    matrices = []
    for mj in (model.mj, theirs):
        data = mujoco.MjData(mj)
        for name, angle in zip(robot.joints, angles, strict=True):
            data.qpos[mj.joint(name).qposadr] = angle
        mujoco.mj_kinematics(mj, data)
        mujoco.mj_comPos(mj, data)
        mujoco.mj_crb(mj, data)
        full = np.zeros((mj.nv, mj.nv))
        mujoco.mj_fullM(mj, data, full)
        places = [mj.joint(name).dofadr[0] for name in robot.joints]
        full -= np.diag(mj.dof_armature)  # rotors are no part of URDF
        matrices.append(full[np.ix_(places, places)])
    assert matrices[1] == pytest.approx(matrices[0], abs=1e-9)


def test_limits_are_those_of_what_is_commanded(robot: RobotDescription, tree: KinematicTree) -> None:
    joints = {joint.get("name"): joint for joint in ElementTree.fromstring(tree.urdf).iter("joint")}
    moving = {name for name, joint in joints.items() if joint.get("type") != "fixed"}
    assert moving == set(robot.joints)
    for name, table in robot.tables.joints.items():
        limit, dynamics = joints[name].find("limit"), joints[name].find("dynamics")
        assert limit is not None and dynamics is not None
        assert float(limit.get("effort", "nan")) == pytest.approx(table.effort)
        assert float(limit.get("velocity", "nan")) == pytest.approx(VELOCITY_FACTOR * table.velocity)
        assert float(dynamics.get("damping", "nan")) == pytest.approx(table.damping)
        bounded = table.lower is not None
        assert joints[name].get("type") == ("revolute" if bounded else "continuous"), name
        if bounded:
            bounds = [float(limit.get(key, "nan")) for key in ("lower", "upper")]
            assert bounds == pytest.approx([table.lower, table.upper]), name


def test_a_hinge_beside_its_link_and_links_that_stand_askew(robot: RobotDescription, tmp_path: Path) -> None:
    """What ESCHER does not have: an anchor, and a link turned straight up."""
    folder = tmp_path / robot.name
    folder.mkdir()
    (folder / "robot.yaml").write_text((robot.folder / "robot.yaml").read_text())
    model = (robot.folder / "model.xml").read_text()
    assert '<joint name="l_elbow_pitch"' in model
    model = model.replace('<joint name="l_elbow_pitch"', '<joint pos="0.02 -0.01 0.03" name="l_elbow_pitch"')
    model = model.replace('<site name="l_gripper"', '<site euler="0.3 1.5707963267948966 0.2" name="l_gripper"')
    (folder / "model.xml").write_text(model)
    askew = RobotDescription.load(folder)
    test_links_and_frames_stand_where_the_model_puts_them(askew, read(askew))


LOOK = """
<geom class="visual" type="mesh" mesh="whole" rgba="0.2 0.4 0.6 1"/>
<geom class="visual" type="mesh" mesh="mirrored" pos="0.1 -0.2 0.3" euler="0.4 -0.5 0.6"/>
<geom class="visual" type="ellipsoid" size="0.1 0.2 0.05" pos="0.1 0 0" euler="0.3 0.2 0.1"/>
<geom class="body" type="mesh" mesh="whole" pos="0 0 -0.4"/>
<geom class="visual" type="mesh" mesh="nowhere"/>
"""


@pytest.fixture(scope="module")
def meshed(tmp_path_factory: pytest.TempPathFactory) -> RobotDescription:
    """A robot in a folder with a space in its name; on its forearm meshes as they lie, mirrored, and in the model."""
    ours = RobotDescription.load(ROBOTS / "escher")
    folder = tmp_path_factory.mktemp("a robot") / "meshed"
    (folder / "meshes").mkdir(parents=True)
    shape = trimesh.creation.box((0.1, 0.2, 0.3))
    askew = np.eye(4)
    askew[:3, :3], askew[:3, 3] = Rotation.from_rotvec((0.2, 0.4, 0.6)).as_matrix(), (0.3, 0.1, -0.2)
    shape.apply_transform(askew)
    shape.export(folder / "meshes" / "shape.stl")
    (folder / "robot.yaml").write_text((ours.folder / "robot.yaml").read_text())
    model = (ours.folder / "model.xml").read_text()
    model = model.replace('angle="radian"', 'angle="radian" meshdir="meshes"', 1)
    meshes = '<mesh name="whole" file="shape.stl"/><mesh name="mirrored" file="shape.stl" scale="1 -0.5 2"/>'
    embedded = '<mesh name="nowhere" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/>'
    model = model.replace("<asset>", f"<asset>{meshes}{embedded}", 1)
    before, body, after = model.partition('<body name="l_forearm"')
    head, end, rest = after.partition(">")
    (folder / "model.xml").write_text(before + body + head + end + LOOK + rest)
    return RobotDescription.load(folder)


def test_meshes_are_shown_from_where_they_lie(meshed: RobotDescription) -> None:
    tree = read(meshed)
    files = [mesh.get("filename") for mesh in ElementTree.fromstring(tree.urdf).iter("mesh")]
    assert files == [*[(meshed.folder / "meshes" / "shape.stl").as_uri()] * 2, SPHERE.as_uri(), files[0]]
    test_shapes_stand_where_the_models_do(meshed, tree)
    (color,) = (m for m in ElementTree.fromstring(tree.urdf).iter("color") if m.get("rgba") == "0.2 0.4 0.6 1")
    assert color is not None


def test_shapes_stand_where_the_models_do(robot: RobotDescription, tree: KinematicTree) -> None:
    """Bounds of each link's shapes, in the link, within a tenth of a millimetre."""
    mj = full_model(robot, "all").mj
    links = {link.get("name"): link for link in ElementTree.fromstring(tree.urdf).iter("link")}
    compared = 0
    for body in range(1, mj.nbody):
        link = links[mj.body(body).name]
        geoms = [g for g in range(mj.ngeom) if mj.geom_bodyid[g] == body]
        for kind in ("visual", "collision"):
            mine = [points_of_geom(mj, g) for g in geoms if (mj.geom_group[g] == 3) == (kind == "collision")]
            seen = [points for points in mine if points is not None]
            theirs = [points_of_shape(part) for part in link.iter(kind)]
            assert bool(seen) == bool(theirs), (mj.body(body).name, kind)
            if seen:
                ours, other = np.concatenate(seen), np.concatenate(theirs)
                assert other.min(axis=0) == pytest.approx(ours.min(axis=0), abs=1e-4), (mj.body(body).name, kind)
                assert other.max(axis=0) == pytest.approx(ours.max(axis=0), abs=1e-4), (mj.body(body).name, kind)
                compared += 1
    assert compared > mj.nbody


def points_of_shape(part: ElementTree.Element) -> FloatArray:
    """(k, 3) of a URDF's shape in its link: corners, or ends of what is round along every axis."""
    origin, shape = part.find("origin"), part.find("geometry/*")
    assert origin is not None and shape is not None

    def numbers(element: ElementTree.Element, key: str) -> list[float]:
        return [float(word) for word in element.get(key, "").split()]

    place = np.array(numbers(origin, "xyz"))
    turn: FloatArray = Rotation.from_euler("xyz", numbers(origin, "rpy")).as_matrix()
    if shape.tag == "mesh":
        file = Path(unquote(urlsplit(shape.get("filename", "")).path))
        if file == SPHERE:
            return ellipsoid(place, turn, np.array(numbers(shape, "scale")))
        points = np.asarray(trimesh.load_mesh(file).vertices) * numbers(shape, "scale")
    elif shape.tag == "box":
        points = np.asarray(trimesh.creation.box(numbers(shape, "size")).vertices)
    elif shape.tag == "sphere":
        return ellipsoid(place, turn, np.repeat(numbers(shape, "radius"), 3))
    else:
        radius, length = numbers(shape, "radius")[0], numbers(shape, "length")[0]
        return cylinder(place, turn, radius, length / 2)
    standing: FloatArray = points @ turn.T + place
    return standing


def points_of_geom(mj: mujoco.MjModel, geom: int) -> FloatArray | None:
    """The same, of the model's; None of a mesh without a file."""
    place: FloatArray = mj.geom_pos[geom]
    turn: FloatArray = np.empty((3, 3))
    mujoco.mju_quat2Mat(turn.reshape(9), mj.geom_quat[geom])
    size, kind = mj.geom_size[geom], mujoco.mjtGeom(mj.geom_type[geom]).name
    if kind == "mjGEOM_MESH":
        mesh = int(mj.geom_dataid[geom])
        if mj.mesh_pathadr[mesh] < 0:
            return None
        first = int(mj.mesh_vertadr[mesh])
        return np.asarray(mj.mesh_vert[first : first + int(mj.mesh_vertnum[mesh])] @ turn.T + place)
    if kind == "mjGEOM_BOX":
        return np.array(list(itertools.product(*zip(-size, size, strict=True)))) @ turn.T + place
    if kind == "mjGEOM_SPHERE":
        return ellipsoid(place, turn, np.repeat(size[0], 3))
    if kind == "mjGEOM_ELLIPSOID":
        return ellipsoid(place, turn, size)
    if kind == "mjGEOM_CYLINDER":
        return cylinder(place, turn, size[0], size[1])
    assert kind == "mjGEOM_CAPSULE"
    ends = (place + size[1] * turn[:, 2], place - size[1] * turn[:, 2])
    return np.concatenate([ellipsoid(end, turn, np.repeat(size[0], 3)) for end in ends])


def ellipsoid(place: FloatArray, turn: FloatArray, radii: FloatArray) -> FloatArray:
    """(2, 3) corners of its bounds."""
    reach = np.linalg.norm(turn * radii, axis=1)
    return np.stack((place - reach, place + reach))


def cylinder(place: FloatArray, turn: FloatArray, radius: float, half: float) -> FloatArray:
    reach = np.abs(turn[:, 2]) * half + np.linalg.norm(turn[:, :2], axis=1) * radius
    return np.stack((place - reach, place + reach))
