"""The URDF is the robot's one model, to others' readers: MuJoCo's importer of URDF, and the XML itself."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from harness.places import ROBOTS
from valor.robot.commanded_limits import VELOCITY_FACTOR
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.valor_ros_controller.kinematic_tree import KinematicTree
from valor.valor_ros_controller.model_tree import read

NAMES = [path.parent.name for path in ROBOTS.glob("*/robot.yaml")]


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
    """At random configurations."""
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
