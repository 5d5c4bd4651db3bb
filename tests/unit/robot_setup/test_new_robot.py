"""Folders from any humanoid's model are valid, stand and walk; other models are rejected in one line."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from harness.generated_robot import Build, mjcf
from harness.places import ROBOTS
from tests.unit.robot_setup.builds import BUILDS, made
from valor.common.errors import ConfigurationError
from valor.control.tuning_tables import Estimator, Tuning
from valor.robot.checks.folder import examine
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.robot.model_tree import read
from valor.robot_setup.new import new_robot
from valor.robot_setup.robot_yaml import VELOCITY_LAG
from valor.self_test.acceptance import SelfTest
from valor.valorctl.demos import demonstration


@pytest.mark.parametrize("name", sorted(BUILDS))
def test_the_folder_is_valid(name: str, tmp_path: Path) -> None:
    build = BUILDS[name]
    robot = made(build, tmp_path)
    examine(robot.folder).require_none()
    foot = robot.tables.feet.left
    if build.sole != "capsules":
        assert (foot.heel, foot.toe, foot.half_width) == pytest.approx(build.heel_toe_half_width, abs=1.5e-3)


def test_a_robot_of_three_kilograms_stands_is_pushed_and_walks(tmp_path: Path) -> None:
    robot = made(BUILDS["3 kg on points"], tmp_path)
    played = {name: play() for name, play in SelfTest(robot, "hardware").tests() if name in {"push forward", "walk"}}
    assert {name: result.reason for name, result in played.items()} == {"push forward": "", "walk": ""}


def test_a_robot_whose_legs_lean_outward_executes_a_plan_and_walks(tmp_path: Path) -> None:
    robot = made(Build(ankle=0.2), tmp_path)
    played = {name: play() for name, play in SelfTest(robot, "hardware").tests() if name in {"six steps", "walk"}}
    assert {name: result.reason for name, result in played.items()} == {"six steps": "", "walk": ""}


def test_ankles_on_narrow_soles_brake_no_faster_than_drives(tmp_path: Path) -> None:
    usual, narrow = made(Build(), tmp_path / "usual"), made(Build(narrow=0.36), tmp_path / "narrow")
    assert usual.read(Tuning).whole_body.limit_response > 40
    response = narrow.read(Tuning).whole_body.limit_response
    assert pytest.approx(1 / (2 * np.pi * Estimator().joint_velocity_bandwidth), rel=0.02) == VELOCITY_LAG
    hardware = narrow.tables.actuators["hardware"]
    assert response < 0.3 / (hardware.torque_lag + hardware.delay + VELOCITY_LAG)
    speeds = [demonstration.speed(robot) for robot in (usual, narrow)]
    assert 0.5 * speeds[0] < speeds[1] < 0.95 * speeds[0]


PASSIVE = ("left_finger_tip", "right_finger_tip", "antenna")


def test_the_file_states_guesses_and_omissions(tmp_path: Path) -> None:
    robot = made(Build(fingers=True, spring=True), tmp_path)
    text = robot.file.read_text()
    assert "guessed: velocity" in text
    passive = {name: next(line for line in text.splitlines() if line.startswith(f"  {name}:")) for name in PASSIVE}
    assert "# follows left_finger" in passive["left_finger_tip"]
    assert "# a spring of 0.1 N·m/rad" in passive["antenna"]
    assert set(robot.tables.passive) == set(PASSIVE)
    assert all(each.simulated for each in robot.tables.passive.values())


def test_a_joint_drawn_away_from_zero_keeps_its_zero(tmp_path: Path) -> None:
    """``ref`` is the angle at which the model shows the joint."""
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


def test_names_invalid_in_files_are_replaced(tmp_path: Path) -> None:
    """Words of YAML, names of other frames, names with spaces."""
    text = mjcf(Build()).replace('"left_knee_y', '"left knee: y').replace('name="head"', 'name="yes"')
    text = text.replace('name="right_forearm"', 'name="base_link"')
    (tmp_path / "model.xml").write_text(text)
    new_robot(tmp_path / "model.xml", tmp_path / "robot", "generated")
    content = yaml.safe_load((tmp_path / "robot" / "robot.yaml").read_text())
    assert any(name.startswith("left_knee_y") for name in content["joints"])
    assert content["head"] == "body_yes" and content["hands"]["right"]["body"] == "base_link_body1"
    assert "is renamed to body_yes" in (tmp_path / "robot" / "robot.yaml").read_text()


def urdf(mesh: str) -> str:
    text = re.sub(r'velocity="[^"]*"', 'velocity="11"', read(RobotDescription.load(ROBOTS / "thor")).urdf)
    pelvis = '<link name="pelvis">'
    return text.replace(pelvis, f'{pelvis}<visual><geometry><mesh filename="{mesh}"/></geometry></visual>')


OBJ = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.mark.parametrize("mesh", ["package://robot_description/meshes/pelvis.obj", "../meshes/pelvis.obj"])
def test_meshes_and_velocities_of_a_urdf_are_read(mesh: str, tmp_path: Path) -> None:
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


def test_a_driven_slide_is_rejected(tmp_path: Path) -> None:
    file = tmp_path / "model.xml"
    file.write_text(mjcf(Build()).replace('name="left_knee', 'type="slide" name="left_knee'))
    with pytest.raises(ConfigurationError, match=r"left_knee.* is driven and slides or is a ball; expected hinges"):
        new_robot(file, tmp_path / "robot", "generated")
