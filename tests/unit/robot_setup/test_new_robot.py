"""A folder out of any humanoid's model: it is sound, it stands and walks; what is none is refused in one line."""

from __future__ import annotations

import os
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.generated_robot import Build, mjcf
from tests.unit.robot_setup.builds import BUILDS, made, written
from valor.common.errors import ConfigurationError
from valor.rehearsal.closed_loop import ClosedLoop
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.robot.soundness import examine
from valor.robot_setup.new import new_robot
from valor.robot_setup.robot_yaml import VELOCITY_LAG
from valor.valorctl import demonstration
from valor.whole_body.tuning_tables import Estimator, Tuning
from valor.whole_body.walking.velocity_steps import VelocitySteps


@pytest.mark.parametrize("name", sorted(BUILDS))
def test_the_folder_is_sound(name: str, tmp_path: Path) -> None:
    build = BUILDS[name]
    robot = made(build, tmp_path)
    examine(robot.folder).require_none()
    foot = robot.tables.feet.left
    if build.sole != "capsules":
        assert (foot.heel, foot.toe, foot.half_width) == pytest.approx(build.heel_toe_half_width, abs=1.5e-3)


@examples(15)
@given(
    build=st.builds(
        Build,
        mass=st.floats(3, 180),
        root=st.sampled_from(("pelvis", "chest")),
        waist=st.sampled_from(("", "z", "zy", "xyz")),
        hip=st.permutations("zxy").map("".join),
        arm=st.sampled_from((0, 4, 5, 6, 7)),
        neck=st.booleans(),
        fingers=st.booleans(),
        spring=st.booleans(),
        knee=st.sampled_from((1, -1)),
        mirrored=st.booleans(),
        drive=st.sampled_from(("motor", "position", "none")),
        gear=st.floats(1, 100),
        sole=st.sampled_from(("points", "box", "mesh", "capsules")),
        together=st.booleans(),
        shuffled=st.booleans(),
        degrees=st.booleans(),
        uneven=st.floats(0, 0.1),
    )
)
def test_any_build_is_sound(tmp_path_factory: pytest.TempPathFactory, build: Build) -> None:
    size = Build(
        **{field: getattr(build, field) for field in build.__dataclass_fields__} | {"leg": 0.18 * build.mass ** (1 / 3)}
    )
    examine(made(size, tmp_path_factory.mktemp("robot")).folder).require_none()


def test_a_robot_of_three_kilograms_stands_is_pushed_and_walks(tmp_path: Path) -> None:
    robot = made(BUILDS["3 kg on points"], tmp_path)
    loop = ClosedLoop(robot, "hardware")
    loop.settle(0.3)
    loop.run(1.0)
    loop.plant.push(np.array([0.2 * 3, 0.0, 0.0]), 0.1)
    loop.run(2.0)
    assert loop.fall is None
    source = loop.controller.step_source = VelocitySteps(robot.tables.walking)
    start, x = loop.time, float(loop.plant.data.qpos[0])

    def walk(loop: ClosedLoop) -> None:
        source.command(np.array([0.12, 0.0, 0.0]), loop.time)
        source.advance(loop.time)

    loop.run(4.0, walk)
    assert loop.fall is None
    assert float(loop.plant.data.qpos[0]) - x > 0.5 * 0.12 * (loop.time - start)


def test_a_robot_on_narrow_soles_walks_over_dirt(tmp_path: Path) -> None:
    """They rock on bumps, with ankles that are never far from a stop."""
    robot = made(Build(mass=33, leg=0.64, sole="points", narrow=0.36, ankle=0.26), tmp_path)
    loop = ClosedLoop(robot, "hardware", seed=1, world=demonstration.WORLD)
    loop.settle(0.3)
    loop.run(1.0)
    source = loop.controller.step_source = VelocitySteps(robot.tables.walking)

    def walk(loop: ClosedLoop) -> None:
        if loop.state.pelvis_position_in_odom[0] < 3.0:
            source.command(np.array([demonstration.speed(robot), 0.0, 0.0]), loop.time)
        source.advance(loop.time)

    while loop.fall is None and (loop.state.pelvis_position_in_odom[0] < 3.0 or loop.controller.stepping):
        loop.run(0.1, walk)
        assert loop.time < 30.0
    assert loop.fall is None


def test_ankles_on_narrow_soles_brake_no_quicker_than_drives(tmp_path: Path) -> None:
    usual, narrow = made(Build(), tmp_path / "usual"), made(Build(narrow=0.36), tmp_path / "narrow")
    assert usual.read(Tuning).whole_body.limit_response > 40
    response = narrow.read(Tuning).whole_body.limit_response
    assert pytest.approx(1 / (2 * np.pi * Estimator().joint_velocity_bandwidth), rel=0.02) == VELOCITY_LAG
    hardware = narrow.tables.actuators["hardware"]
    assert response < 0.3 / (hardware.torque_lag + hardware.delay + VELOCITY_LAG)
    speeds = [demonstration.speed(robot) for robot in (usual, narrow)]
    assert 0.5 * speeds[0] < speeds[1] < 0.95 * speeds[0]


PASSIVE = ("left_finger_tip", "right_finger_tip", "antenna")


def test_the_file_says_what_it_guessed_and_left_out(tmp_path: Path) -> None:
    robot = made(Build(fingers=True, spring=True), tmp_path)
    text = robot.file.read_text()
    assert "guessed: velocity" in text
    passive = {name: next(line for line in text.splitlines() if line.startswith(f"  {name}:")) for name in PASSIVE}
    assert "# follows left_finger" in passive["left_finger_tip"]
    assert "# a spring of 0.1 N·m/rad" in passive["antenna"]
    assert set(robot.tables.passive) == set(PASSIVE)
    assert all(each.simulated for each in robot.tables.passive.values())


def test_a_joint_drawn_away_from_zero_has_its_zero_where_the_maker_has_it(tmp_path: Path) -> None:
    """With ``ref`` the drawing shows the joint at that angle."""
    text = mjcf(Build()).replace('name="left_arm_y_', 'ref="0.5" name="left_arm_y_')
    (tmp_path / "model.xml").write_text(text)
    new_robot(tmp_path / "model.xml", tmp_path / "robot", "generated")
    maker = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    model = full_model(RobotDescription.load(tmp_path / "robot"), "none").mj
    away = []
    for mj in (maker, model):
        data = mujoco.MjData(mj)
        data.qpos[7:] = 0.0
        mujoco.mj_kinematics(mj, data)
        away.append(data.body("left_forearm").xpos - data.body("pelvis").xpos)
    assert away[1] == pytest.approx(away[0], abs=1e-6)


def test_names_that_files_do_not_take_are_replaced(tmp_path: Path) -> None:
    """Of YAML, of other frames, with spaces."""
    text = mjcf(Build()).replace('"left_knee_y', '"left knee: y').replace('name="head"', 'name="yes"')
    text = text.replace('name="right_forearm"', 'name="base_link"')
    (tmp_path / "model.xml").write_text(text)
    new_robot(tmp_path / "model.xml", tmp_path / "robot", "generated")
    content = yaml.safe_load((tmp_path / "robot" / "robot.yaml").read_text())
    assert any(name.startswith("left_knee_y") for name in content["joints"])
    assert content["head"] == "body_yes"
    assert content["hands"]["right"]["body"] == "base_link_body1"
    assert "is called body_yes" in (tmp_path / "robot" / "robot.yaml").read_text()


def urdf(mesh: str) -> str:
    """A robot of URDF with a mesh on its pelvis: legs of six joints, no arms."""
    links, joints = [], []

    def link(name: str, mass: float, shape: str = "") -> None:
        inertia = " ".join(
            f'{key}="{0.002 * mass if key[1] == key[2] else 0}"' for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        )
        links.append(
            f'<link name="{name}"><inertial><mass value="{mass}"/><inertia {inertia}/></inertial>{shape}</link>'
        )

    def geometry(kind: str, what: str, at: str = "0 0 0") -> str:
        return f'<{kind}><origin xyz="{at}"/><geometry>{what}</geometry></{kind}>'

    def joint(name: str, parent: str, child: str, at: str, axis: str, low: float, high: float) -> None:
        joints.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/>'
            f'<axis xyz="{axis}"/><limit lower="{low}" upper="{high}" effort="100" velocity="11"/></joint>'
        )

    link(
        "pelvis",
        20,
        geometry("visual", f'<mesh filename="{mesh}"/>') + geometry("collision", '<box size=".2 .2 .3"/>', "0 0 .15"),
    )
    for side, y in (("l", 0.1), ("r", -0.1)):
        turns = [("hip_z", f"0 {y} 0", "0 0 1", -0.6, 0.6), ("hip_x", "0 0 0", "1 0 0", -0.6, 0.6),
                 ("hip_y", "0 0 0", "0 1 0", -1.5, 0.8), ("knee", "0 0 -0.35", "0 1 0", 0.0, 2.0),
                 ("ankle_y", "0 0 -0.35", "0 1 0", -0.9, 0.7), ("ankle_x", "0 0 0", "1 0 0", -0.4, 0.4)]  # fmt: skip
        parent = "pelvis"
        for name, at, axis, low, high in turns:
            child = f"{side}_{name}_link"
            foot = geometry("collision", '<box size=".2 .1 .03"/>', "0.03 0 -0.055") if name == "ankle_x" else ""
            link(child, 1.0, foot)
            joint(f"{side}_{name}", parent, child, at, axis, low, high)
            parent = child
    return f'<robot name="r">{"".join(links)}{"".join(joints)}</robot>'


OBJ = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.mark.parametrize("mesh", ["package://robot_description/meshes/pelvis.obj", "../meshes/pelvis.obj"])
def test_a_urdf_finds_its_meshes_and_says_speeds(mesh: str, tmp_path: Path) -> None:
    package = tmp_path / "robot_description"
    for folder in ("urdf", "meshes"):
        (package / folder).mkdir(parents=True)
    (package / "package.xml").write_text("<package/>")
    (package / "meshes" / "pelvis.obj").write_text(OBJ)
    (package / "urdf" / "robot.urdf").write_text(urdf(mesh))
    new_robot(package / "urdf" / "robot.urdf", tmp_path / "robot", "generated")
    content = yaml.safe_load((tmp_path / "robot" / "robot.yaml").read_text())
    assert {joint["velocity"] for joint in content["joints"].values()} == {11}
    assert [file.suffix for file in (tmp_path / "robot" / "meshes").iterdir()] == [".stl"]


SLIDING = mjcf(Build()).replace('name="left_knee', 'type="slide" name="left_knee')
MISSING = mjcf(Build()).replace("<worldbody>", '<asset><mesh file="gone.stl"/></asset><worldbody>')
FAULTS = {
    "five joints a leg": (mjcf(Build(leg_joints=5)), r"leg has 5 driven joints \(.*knee.*\); expected six"),
    "one leg": (mjcf(Build(legs=("left",), arm=0, neck=False)), "no two legs found"),
    "a driven slide": (SLIDING, "left_knee.* slides or is a ball; expected hinges"),
    "feet without shape": (mjcf(Build(sole="none")), "body left_foot: no flat underside found"),
    "xacro": ('<robot xmlns:xacro="x"><xacro:include filename="a"/></robot>', "is a xacro file"),
    "a missing mesh": (MISSING, r"gone\.stl"),
    "no XML": ("stand up and walk", "XML"),
    "URDF that is cut off": ("<robot name='r'><link", "unclosed token|no element found"),
    "no robot in it": ("<mujoco/>", "no bodies|expected a robot"),
    "nothing": ("", "."),
}


@pytest.mark.parametrize("fault", sorted(FAULTS))
def test_what_cannot_be_made_is_refused_in_one_line(fault: str, tmp_path: Path) -> None:
    text, why = FAULTS[fault]
    file = tmp_path / "model.xml"
    file.write_text(text)
    with pytest.raises(ConfigurationError) as refused:
        new_robot(file, tmp_path / "robot", "generated")
    assert str(refused.value).startswith(f"{file}: ")
    assert re.search(why, str(refused.value)), refused.value
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "robot").exists()


def test_a_file_that_is_not_there_or_not_readable_is_named(tmp_path: Path) -> None:
    for file in (tmp_path / "gone.xml", tmp_path):
        with pytest.raises(ConfigurationError, match=re.escape(f"{file}: expected a file")):
            new_robot(file, tmp_path / "robot", "generated")


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads everything")
def test_a_file_that_may_not_be_read_is_named(tmp_path: Path) -> None:
    file = written(Build(), tmp_path)
    file.chmod(0)
    with pytest.raises(ConfigurationError, match=re.escape(f"{file}: ")):
        new_robot(file, tmp_path / "robot", "generated")
